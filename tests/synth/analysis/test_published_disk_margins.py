"""Disk margins that manuals, papers and the tests of other packages print, of one loop and of several at once.

MathWorks' bounds of the structured singular value are 0.2 % apart, and gains and phases are printed for the lower: here
the value lies between both, and is exact, for the factors found bring the loop to the stability boundary.

Sources: MathWorks, Robust Control Toolbox, pages `diskmargin`, `dm2gm`, `gm2dm`, `getDPM`, "Stability Analysis Using
Disk Margins", "MIMO Stability Margins for Spinning Satellite"; python-control, `margin_test.py` and issue #947;
RobustAndOptimalControl.jl, `test_diskmargin.jl`; optimalcontrol, `test_analyze.py`; Seiler, Packard and Gahinet (2020),
IEEE Control Systems 40(5), 78; Doyle (1978), IEEE Trans. AC 23, 756; Safonov and Athans (1977), IEEE Trans. AC 22, 173;
Skogestad and Postlethwaite (2005), Multivariable Feedback Control, sections 3.7.1 and 3.7.2.
"""

import numpy as np
import pytest

from synth import StateSpace, diskmargin, lqr, margin, margins, system
from synth.analysis.diskmargins import DiskMargin, diskmargin_at
from synth.analysis.stabilitymargins import one_loop

DIGIT = 1e-4  # the last one printed


@pytest.mark.parametrize(
    ("alpha", "skew", "gain", "phase"),
    [
        (0.5, 0, (0.6, 1.6667), 28.0725),
        (0.6, 0.75, (0.6066, 2.2632), 34.2267),
        (0.75, -0.5, (0.3684, 1.9231), 41.7908),
        (0.75, 0, (0.4545, 2.2), 41.1121),
        (0.75, 0.5, (0.52, 2.7143), 41.7908),
        (0.6646, 0, (10**-0.3, 10**0.3), 36.7633),
    ],
)
def test_gains_and_phases_of_disks(alpha, skew, gain, phase):
    """`dm2gm`; the last one is 6 dB by `gm2dm`."""
    disk = DiskMargin(alpha, 0.0, skew)
    assert disk.gain == pytest.approx(gain, abs=2 * DIGIT)
    assert disk.phase_deg == pytest.approx(phase, abs=DIGIT)


@pytest.mark.parametrize(("low", "high", "phase"), [(0.3, 2, 45.9208), (0.6, 1.7, 28.5667)])
def test_phase_of_a_disk_from_its_gains(low, high, phase):
    """`getDPM`; "Stability Analysis" prints 29 deg for the second."""
    v = (2 * (low + high) - 4) / (high - low)  # (1 + skew) alpha
    u = high * (2 - v) - 2  # (1 - skew) alpha
    disk = DiskMargin((u + v) / 2, 0.0, (v - u) / (u + v))
    assert disk.gain == pytest.approx((low, high), rel=1e-12)
    assert disk.phase_deg == pytest.approx(phase, abs=DIGIT)


@pytest.mark.parametrize(
    ("skew", "low", "high"), [(-2, 0.4013, 1.3745), (0, 0.6273, 1.5942), (2, 0.7717, 1.7247)], ids=str
)
def test_skewed_disks_of_the_introduction(skew, low, high):
    """`diskmargin(L, sigma)`: gains that decrease, change alike, increase."""
    assert diskmargin(system([25], [1, 10, 10, 10]), skew=skew).gain == pytest.approx((low, high), abs=DIGIT)


def satellite(c: float = 10.0, damping: float = 0.0) -> StateSpace:
    """Transversal rates of a spinning body."""
    return StateSpace([[-damping, 10.0], [-10.0, -damping]], np.eye(2), [[1.0, c], [-10.0, 1.0]], np.zeros((2, 2)))


CROSSED = np.array([[1.0, -2.0], [0.0, 1.0]])


def is_exact(L: StateSpace, disk: DiskMargin) -> bool:
    """Whether factors of the size of the disk bring a pole to the boundary."""
    delta = 2 * (disk.factors - 1) / ((1 + disk.skew) * disk.factors + 1 - disk.skew)
    poles = np.linalg.eigvals(L.A - L.B @ np.diag(disk.factors) @ L.C)
    return bool(abs(poles.real.max()) < 1e-6 and abs(delta).max() < disk.alpha * (1 + 1e-6))


@pytest.mark.parametrize("end", ["input", "output"])
@pytest.mark.parametrize("a", [1.0, 10.0, 100.0])
def test_spinning_satellite(a, end):
    """.0998 in RobustAndOptimalControl.jl for a = 10, 2 (sqrt(a^2 + 1) - a) exactly: a phase of atan(1 / a)."""
    P = StateSpace([[0, a], [-a, 0]], np.eye(2), [[1, a], [-a, 1]], np.zeros((2, 2)))
    found = margins(P, np.eye(2))
    disk = getattr(found, f"disk_{end}")
    assert disk.alpha == pytest.approx(2 * (np.hypot(a, 1) - a), rel=1e-6)
    assert disk.phase == pytest.approx(np.arctan(1 / a), rel=1e-6)
    assert is_exact(getattr(found.loops, end), disk)
    if a == 10:
        assert disk.alpha == pytest.approx(0.0998, abs=DIGIT)
    for one in getattr(found, end):  # each loop alone is 1/s
        assert (one.gain_up, one.gain_down) == (np.inf, 0)
        assert one.phase_deg == pytest.approx(90, rel=1e-9)
    for one in getattr(found, f"disk_{end}s"):
        assert one.alpha == pytest.approx(2, rel=1e-9)
        assert one.phase_deg == pytest.approx(90, rel=1e-9)


def test_spinning_satellite_at_both_ends():
    """.0499 in RobustAndOptimalControl.jl: half the phase of one end."""
    disk = margins(satellite(), np.eye(2)).disk_both
    assert disk.alpha == pytest.approx(0.0499, abs=DIGIT)
    assert disk.phase == pytest.approx(np.arctan(0.1) / 2, rel=1e-6)


@pytest.mark.parametrize(
    ("c", "end", "lower", "upper", "gain", "phase"),
    [
        (10, "input", 0.3754, 0.3762, (0.6839, 1.4621), 21.2607),
        (10, "output", 0.3754, 0.3762, (0.6839, 1.4621), 21.2607),
        (8, "output", 0.4890, 0.4899, (0.6071, 1.6472), 27.4762),
    ],
)
def test_crossed_satellite(c, end, lower, upper, gain, phase):
    """MathWorks' `diskmargin`, MM; python-control prints 3.3 dB for the first two."""
    found = margins(satellite(c), CROSSED)
    disk = getattr(found, f"disk_{end}")
    assert lower - DIGIT < disk.alpha < upper + DIGIT
    assert is_exact(getattr(found.loops, end), disk)
    assert DiskMargin(lower, 0.0).gain == pytest.approx(gain, abs=DIGIT)
    assert DiskMargin(lower, 0.0).phase_deg == pytest.approx(phase, abs=0.003)
    assert disk.gain == pytest.approx(gain, rel=2e-3)
    assert disk.phase_deg == pytest.approx(phase, rel=2.2e-3)
    if c == 10:
        assert disk.gain_db == pytest.approx(3.3, abs=0.1)


@pytest.mark.parametrize(("c", "end"), [(10, "input"), (10, "output"), (8, "output")])
def test_crossed_satellite_one_loop_at_a_time(c, end):
    """MathWorks' DM: any gain, 90 deg, a disk of 2."""
    for disk in getattr(margins(satellite(c), CROSSED), f"disk_{end}s"):
        assert disk.alpha == pytest.approx(2, rel=1e-9)
        low, high = disk.gain
        assert low < 1e-9
        assert high > 1e9
        assert disk.phase_deg == pytest.approx(90, rel=1e-9)


def rocket() -> StateSpace:
    """RobustAndOptimalControl.jl's loop of three signals, in units that differ by ten powers of ten."""
    A, B, C, D = np.eye(5), np.zeros((5, 3)), np.zeros((3, 5)), np.zeros((3, 3))
    A[0, 2], A[1, 2], A[1, 3], A[3, 4], A[4, 4] = 9.84, 0.01, 2.14634e-6, -1.73983959887, 0.56597684805
    B[0, 1:], B[2, 2], B[3:, 1] = (4.901416e-5, 1.9883878e-4), 4.041439e-5, (-0.02004649371, -0.00490141631)
    C[0, 1], C[1, 0], C[2, 0], C[2, 2] = -0.83516488404, 186.74725411661, -7.44299057498, 7035.08410814126
    D[1:, 0] = 34875.36444283988, 48304.01940122544
    return StateSpace(A, B, C, D, 0.01)


def test_rocket_loop():
    """The structured singular value of T, whose inverse is the disk of skew -1: 1 at .01 rad/s, 2.503148529 at most."""
    L = rocket()
    disk = diskmargin(L, skew=-1)
    assert 1 / disk.alpha == pytest.approx(2.503148529, rel=1e-6)
    low, peak = 1 / diskmargin_at(L, [0.01, disk.frequency], skew=-1)
    assert low == pytest.approx(1, rel=1e-3)
    assert peak == pytest.approx(1 / disk.alpha, rel=1e-9)


def test_rocket_loop_one_at_a_time():
    """.794418 is printed for the first loop at 4.05 rad/s, tested to 1e-3 there; from the matrices it is .795039."""
    L, omega = rocket(), 4.05
    G = L.C @ np.linalg.solve(np.exp(1j * omega * L.dt) * np.eye(5) - L.A, L.B) + L.D
    alone = G[0, 0] - G[0, 1:] @ np.linalg.solve(np.eye(2) + G[1:, 1:], G[1:, 0])
    true = 1 / abs(1 / (1 + alone) - 0.5)
    assert true == pytest.approx(0.794418036911981, rel=1e-3)
    assert diskmargin_at(one_loop(L, 0), [omega])[0] == pytest.approx(true, rel=1e-9)


def test_aircraft_with_a_linear_quadratic_regulator():
    """1.8633 at 27.1 rad/s, .0354 to 28.2696 and 85.9 deg in `test_analyze.py`: a bound; the value is 1.8671."""
    A = np.array(
        [
            [-0.2529, 0.6962, -1.9870, -9.7491, 0],
            [-0.6108, -3.6183, 19.4199, -0.9979, 0],
            [0.3036, -2.9669, -4.2358, 0, 0],
            [0, 0, 1, 0, 0],
            [0.1018, -0.9948, 0, 20, 0],
        ]
    )
    B = np.zeros((5, 2))
    B[:3, 0], B[0, 1] = (-0.0025, -1.6575, -23.1119), 5.3843
    Q, R = np.diag([1, 1, np.deg2rad(30) ** -2, np.deg2rad(5) ** -2, 1e-4]), np.diag([np.deg2rad(30) ** -2, 1])
    L = StateSpace(A, B, lqr(A, B, Q, R)[0], np.zeros((2, 2)))
    disk = diskmargin(L)
    assert is_exact(L, disk)
    assert disk.alpha >= 1.8633
    assert disk.alpha == pytest.approx(1.8633, rel=3e-3)
    assert disk.frequency == pytest.approx(27.1031, abs=0.1)
    assert disk.phase_deg == pytest.approx(85.9482, rel=2e-3)
    assert disk.gain == pytest.approx((0.0354, 28.2696), rel=0.03)
    guaranteed = diskmargin(L, skew=1)  # Safonov and Athans: half the gain, any higher one, 60 deg in every channel
    assert guaranteed.alpha == pytest.approx(1, rel=1e-9)
    assert guaranteed.gain[0] == pytest.approx(0.5, rel=1e-9)
    assert guaranteed.phase_deg == pytest.approx(60, rel=1e-9)


@pytest.mark.parametrize("q", [60.0, 1e3, 1e4])
def test_no_guaranteed_margins(q):
    """Doyle's regulator with q = sigma: the gain 1 + 1/(d f), d = f = 2 + sqrt(4 + q), is the last that is borne."""
    f = 2 + np.sqrt(4 + q)
    A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    feedback, filtering = np.array([[f, f]]), np.array([[f], [f]])
    K = StateSpace(A - B @ feedback - filtering @ C, filtering, feedback, [[0.0]])
    found = margins(StateSpace(A, B, C, [[0.0]]), K).input[0]
    assert found.gain_up == pytest.approx(1 + 1 / f**2, rel=1e-9)
    assert found.gain_down > 1 - (f - 2) / f**2  # his other condition, not the first to be met


def test_distillation_column_with_its_inverse():
    """Skogestad and Postlethwaite, 3.7.2: any gain and 90 deg at either end, though both together bear little."""
    G = np.array([[87.8, -86.4], [108.2, -109.6]])
    P = StateSpace(-np.eye(2) / 75, np.eye(2) / 75, G, np.zeros((2, 2)))
    inverse = 0.7 * np.linalg.inv(G)
    found = margins(P, StateSpace(np.zeros((2, 2)), np.eye(2), inverse, 75 * inverse))
    for one in (*found.input, *found.output):
        assert (one.gain_up, one.gain_down) == (np.inf, 0)
        assert one.phase_deg == pytest.approx(90, rel=1e-9)
        assert one.phase_frequency == pytest.approx(0.7, rel=1e-9)
    assert (found.disk_input.alpha, found.disk_output.alpha) == pytest.approx((2, 2), rel=1e-6)


GIVEN = {
    "PD on a double integrator": (
        [[-1.1775693440128314e-16, -3.9252311467094367e-17], [-0.9999999999999998, -4.598694340586186e-17]],
        [[1.0, -1.0000000000000002]],
        (np.inf, 0.0, np.nan),
        (np.arctan(np.sqrt((1 + np.sqrt(5)) / 2)), np.sqrt((1 + np.sqrt(5)) / 2)),
    ),
    "(s^2 + s/2 + 1/20)/s^3": (
        [
            [1.069554749235647e-16, 2.7814686080352544e-17, -3.022235517462172e-17],
            [1.0000000000000002, -3.9354928153197674e-17, 7.468018762891145e-17],
            [0.0, -0.1, -1.506581759155993e-17],
        ],
        [[1.0, 0.5, -0.5]],
        (np.inf, 0.1, np.sqrt(0.05)),
        (np.deg2rad(63.84244593481324), 1.0649862511565864),
    ),
}


@pytest.mark.parametrize("name", GIVEN)
def test_matrices_that_python_control_gives(name):
    """Integrators, rounded: poles at 1e-16 or 1e-8 either side of the axis (#947 and its kind)."""
    A, C, (up, down, gain_at), (phase, phase_at) = GIVEN[name]
    found = margin(StateSpace(A, np.eye(len(A), 1), C, [[0.0]]))
    assert (found.gain_up, found.gain_down) == pytest.approx((up, down), rel=1e-6)
    assert found.gain_frequency == pytest.approx(gain_at, rel=1e-6, nan_ok=True)
    assert (found.phase, found.phase_frequency) == pytest.approx((phase, phase_at), rel=1e-9)
