import pytest
from table3 import FORMS, MODEL, SOFT, TABLE_3

from synth.predictive.horizon import mpc


@pytest.fixture(scope="module")
def controllers():
    """The study's controller in both forms, without and with a delay of one sample."""
    return {(f, d): mpc(MODEL, form=f, delay=d, **TABLE_3, **SOFT) for f in FORMS for d in (0, 1)}
