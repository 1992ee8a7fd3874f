"""What a study's sampled loops do between their samples: the gain at the sampling instants beside the one at all times.

The loop of a question is that of `plants.outcome.boxes` at nominal parameters: a disturbance at the plant's input, a
law that samples the output and holds its command. At the samples the disturbance is held as the command is; between
them it is any signal. The norms are `synth`'s, which this package does not know: `table` is handed it as a module.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from plants.outcome.boxes import Question
from plants.outcome.study import Table

TITLE = "Between the samples"
NOTE = (
    "At the samples: disturbances held over a period, the output seen at the sampling instants, which is all that a "
    "sampled model knows. At all times: any disturbance, the output also between the samples (sdhinfnorm)."
)


def gains(q: Question, synth: Any) -> tuple[float, float]:
    """Largest gain of a loop at nominal parameters, at the samples and at all times; inf for an unstable loop.

    Parameters
    ----------
    synth : the module: `StateSpace`, `GeneralizedPlant`, `c2d`, `feedback`, `series`, `hinfnorm`, `sdhinfnorm`
    """
    A, B, C, D = q.linear(np.asarray(q.model.nominal))
    (ny, nu), k = D.shape, len(q.shown)
    at = synth.feedback(synth.c2d(synth.StateSpace(A, B, C, D), q.law.dt), q.law, 1)
    P = synth.GeneralizedPlant(
        A, B, B, q.shown @ C, np.zeros((k, nu)), np.zeros((k, nu)), C, np.zeros((ny, nu)), np.zeros((ny, nu))
    )
    return synth.hinfnorm(synth.series(at, q.shown))[0], synth.sdhinfnorm(P, q.law).upper


def tables(questions: Sequence[Question], synth: Any, *, quantity: str) -> list[Table]:
    """One table for all loops, none without questions; `quantity` says what the gains are, with their unit."""
    rows = []
    for q in questions:
        sampled, always = gains(q, synth)
        more = "not stable" if np.isinf(always) else f"{100 * (always / sampled - 1):+.2f} %"
        rows.append((q.controller, f"{q.law.dt:g}", f"{sampled:.5g}", f"{always:.5g}", more))
    headers = ("controller", "period, s", "at the samples", "at all times", "more")
    return [Table(TITLE, headers, rows, note=f"{quantity}. {NOTE}")] if rows else []
