"""Pictures of Hankel singular values: how many states a system needs.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.analysis.hankel import hsvd
from synth.analysis.reduce import Reduction
from synth.delivery.curves import axes_for, light_grid, lines_style, shown

LEAST = 1e-16  # of the largest value: what is drawn


def hsvplot(systems: Any, ax: Any = None, *, label: str | None = None, **style: Any) -> Any:
    """Hankel singular values on a logarithmic axis; modes that are not stable have infinite ones, told by the legend.

    Parameters
    ----------
    systems : a system in any form that `synth.system` takes, a Design (its closed loop from w to z), or a list,
        tuple or dict of them; the keys of a dict are the labels
    ax : axes to draw on; new ones by default
    label : for the legend
    style : of the markers, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError : what is given is no system, or does not fit the axes.
    NumericalError : as `synth.hsvd`.
    """
    values = [(name, hsvd(G)) for name, G in shown(systems, label, loops=False)]
    ((axes,),) = axes_for(ax, 1, 1, size=(4.8, 3.6))
    for name, sigma in values:
        _draw(axes, sigma, name, style)
    return axes


def reduction_plot(found: Reduction, ax: Any = None, **style: Any) -> Any:
    """Hankel singular values of a reduced system, a line behind those that were kept, and the error as measured.

    Raises
    ------
    ModelError : `ax` is no axes.
    """
    ((axes,),) = axes_for(ax, 1, 1, size=(4.8, 3.6))
    _draw(axes, found.singular_values, style.pop("label", None), style)
    axes.axvline(found.order + 0.5, color="0.4", lw=0.8, ls="--", label=f"order {found.order}")
    if found.error > 0:
        axes.axhline(found.error, color="C3", lw=0.8, ls=":", label=f"measured error {found.error:.3g}")
    axes.legend(fontsize="small")
    return axes


def _draw(axes: Any, sigma: np.ndarray, name: str | None, style: dict[str, Any]) -> None:
    """The values by their number from 1, those that are rounding left out."""
    infinite = int(np.isinf(sigma).sum())
    finite = sigma[infinite:]
    number = infinite + 1 + np.arange(len(finite))
    drawn = finite > LEAST * finite.max(initial=0.0)
    words = [name, f"{infinite} not stable"] if infinite else [name or "Hankel singular values"]
    plain: dict[str, Any] = {"marker": "o", "linestyle": "none", "label": ", ".join(filter(None, words))}
    axes.plot(number[drawn], finite[drawn], **plain | lines_style(style))
    if drawn.any():
        axes.set_yscale("log")
    axes.set(xlabel="state", ylabel="Hankel singular value")
    axes.xaxis.get_major_locator().set_params(integer=True)
    light_grid(axes)
    axes.legend(fontsize="small")
