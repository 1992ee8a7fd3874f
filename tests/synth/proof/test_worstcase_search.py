"""What the search for worst cases and the halving of boxes do at the edge of what they can."""

import numpy as np
from uncertain import flexible_satellite

from synth.analysis import worstcase
from synth.analysis.worstcase import Numbers
from synth.proof.boxes import Boxes, explored


def test_boxes_that_all_hold_are_proved_however_few_were_wanted():
    start = Boxes(np.ones((3, 1, 2)), np.zeros((3, 1)), np.zeros((3, 1)), np.ones((3, 1)), np.arange(3))
    assert explored(start, lambda boxes: np.ones(len(boxes.low), bool), 0, lambda _: None).proved
    left = explored(start, lambda boxes: np.zeros(len(boxes.low), bool), 0, lambda _: None).left
    assert left is not None
    assert len(left.low) == 3


def test_poles_are_found_where_the_first_iteration_of_lapack_does_not_end(monkeypatch):
    monkeypatch.setattr(worstcase, "SINGULAR", 0.0)  # as if the mass matrix might send poles to infinity
    G, tries = flexible_satellite(20), []
    N = Numbers(G, list(G.parameters.values()))
    expected, whole = N.poles(np.zeros(3)), worstcase.sla.eigvals

    def stubborn(A, B, **options):
        tries.append(0)
        if len(tries) % 3:
            raise np.linalg.LinAlgError("did not converge")
        return whole(A, B, **options)

    monkeypatch.setattr(worstcase.sla, "eigvals", stubborn)
    found = N.poles(np.zeros(3))
    assert len(tries) == 3
    assert np.abs(np.subtract.outer(found, expected)).min(axis=1).max() < 1e-9
