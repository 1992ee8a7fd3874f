"""Gains, solutions and poles that peers printed, each to its last printed digit; `test_published.py` has a few more.

A number is read with its digits: half a unit of the last one is allowed, or 1e-11 of the largest entry where more
digits were printed than double precision keeps.
"""

import re
from decimal import Decimal
from typing import NamedTuple

import numpy as np
import pytest
from riccati_examples import Example, quadratic
from riccati_oracle import check_regulator, options, truth

from synth import dlqr, lqr

ENOUGH = 1e-11
REAL = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?")


class Printed(NamedTuple):
    """A regulator, and what was printed of it as text: rows by semicolons."""

    function: object  # lqr or dlqr
    problem: Example
    K: str = ""
    S: str = ""
    poles: str = ""


def matrix(text: str) -> np.ndarray:
    return np.array([[float(x) for x in row.split()] for row in text.split(";")])


def pose(A: str, B: str, Q, R, N="", E="") -> Example:
    """A regulator's data; a number for Q or R is that multiple of the identity."""
    a, b = matrix(A), matrix(B)
    q, r = (
        v * np.eye(n) if isinstance(v, int | float) else matrix(v) if isinstance(v, str) else v
        for v, n in ((Q, len(a)), (R, b.shape[1]))
    )
    return Example(a, b, q, r, N=matrix(N) if N else None, E=matrix(E) if E else None)


def of_outputs(A: str, B: str, C: str, D: str, Q: str, R: str, N: str = "") -> Example:
    """The weights Q, R and N of outputs and commands (`lqry`) as those of states and commands."""
    a, b, c, d, q, r = map(matrix, (A, B, C, D, Q, R))
    n = matrix(N) if N else np.zeros((len(c), b.shape[1]))
    return Example(a, b, quadratic(c, q), r + d.T @ q @ d + d.T @ n + n.T @ d, N=c.T @ (q @ d + n))


def filter_of(A: str, G: str, C: str, Q: str, R: str) -> Example:
    """The dual problem of a Kalman filter (`lqe`), K = L'."""
    a, g, c, q, r = map(matrix, (A, G, C, Q, R))
    return Example(a.T, c.T, quadratic(g.T, q), r)


INTEGRATORS = "0 1; 0 0", "0; 1"
AIRCRAFT = "-0.313 56.7 0; -0.0139 -0.426 0; 0 56.7 0", "0.232; 0.0203; 0"
CART = "0 1 0 0; 0 -0.1 3 0; 0 0 0 1; 0 -0.5 30 0", "0; 2; 0; 5"
COUPLED = (
    "0 0 1 0; 0 0 0 1; -0.24 0 -1 0; 0 -0.24 0 -1", "0 0; 0 0; 1 0; 0 1",
    "-0.3 -0.24 1 -0.4; 6 -0.2 10 -0.5", "0 1; 0 1", "1 0; 0 1", "1 0; 0 1", "1 0; 0 1",
)  # fmt: skip


def pendulum() -> tuple[np.ndarray, np.ndarray]:
    """Cart of .5 kg, pendulum of .2 kg, .006 kg m^2, .3 m, friction .1 N s/m. Control Tutorials (CTMS), Michigan."""
    M, m, b, I, g, l = 0.5, 0.2, 0.1, 0.006, 9.8, 0.3
    p = I * (M + m) + M * m * l * l
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1
    A[1, 1:3] = -(I + m * l * l) * b / p, m * m * g * l * l / p
    A[3, 1:3] = -m * l * b / p, m * g * l * (M + m) / p
    return A, np.array([[0], [(I + m * l * l) / p], [0], [m * l / p]])


CASES = {
    # Altair Compose 2021, help of lqr, lqry, dlqr, lqe, care and dare
    "Altair lqr": Printed(
        lqr, pose("0.8 0; 0.8 1", "0.6; 0.6", "0 0; 0 1", 1),
        "0.00000 6.16228", "8.21637 -8.21637; -8.21637 18.48683", "-1.26491 -0.63246",
    ),
    "Altair lqr, aircraft": Printed(
        lqr, pose(*AIRCRAFT, "0 0 0; 0 0 0; 0 0 2", 1), "-0.50335 52.86451 1.41421",
        "1.41413 -40.95711 -1.66409; -40.95711 3072.24438 88.68382; -1.66409 88.68382 3.64894",
    ),
    "Altair lqry": Printed(
        lqr, of_outputs("0.9 0.25; 0 0.8", "0; 1", "1 0", "0", "2", "1"), "12.73999 3.44764",
        "89.05966 12.73999; 12.73999 3.44764", "-0.87382+0.19637j -0.87382-0.19637j",
    ),
    "Altair lqry, transfer function": Printed(
        lqr, of_outputs("-6 -1; 1 0", "1; 0", "0 1", "0", "2", "1"), "0.12079 0.73205",
        "0.12079 0.73205; 0.73205 4.60152",
    ),
    "Altair dlqr": Printed(
        dlqr, pose("9 0.2; 0 8", "0; 1", "2 1; 1 2", 1), "394.61003 16.76761",
        "1.04036e+07 2.34349e+05; 2.34349e+05 5.34387e+03", "0.11073 0.12166",
    ),
    "Altair lqe": Printed(
        lqr, filter_of("0 1; -1 -1", "1 0; 0 1", "1 0", "0.01 0; 0 0.01", "0.01"), "0.86121 -0.12916",
        "0.00861 -0.00129; -0.00129 0.00621", "-0.93060+0.93060j -0.93060-0.93060j",
    ),
    "Altair care": Printed(
        lqr, pose("-15 1; 0.5 5", "0; 5", "25 -2.5; -2.5 0.25", 1.5), "-0.22552 2.03752",
        "0.82854 -0.06766; -0.06766 0.61126", "-15.16316 -5.02446",
    ),
    "Altair dare": Printed(
        dlqr, pose("4 1.7; 0.9 38", "8; 21", "100 -10; -10 1", 3), "-0.01271 2.00364",
        "1704.70115 -5616.08147; -5616.08147 19597.56409", "0.00296 0.02222",
    ),
    # Octave, package control 3.4.0, tests of care.m and dare.m; the first is MATLAB's and R's example of care, too
    "Octave care": Printed(
        lqr, pose("-3 2; 1 1", "0; 1", "1 -1; -1 1", 3), "0.6072 2.9396", "0.5895 1.8216; 1.8216 8.8188",
        "-3.5026 -1.4370",
    ),
    "R care": Printed(
        lqr, pose("-3 2; 1 1", "0; 1", "1 -1; -1 1", 3), "0.6071916 2.939613", "0.5895174 1.821575; 1.8215747 8.818840",
        "-3.502629 -1.436984",
    ),
    "Octave care, integrators": Printed(
        lqr, pose(*INTEGRATORS, 1, 1), "1.0000 1.7321", "", "-0.8660+0.5000j -0.8660-0.5000j"
    ),
    "Octave care, descriptor": Printed(lqr, pose(*INTEGRATORS, 1, 1, E="1 0; 0 1"), "", "1.7321 1.0000; 1.0000 1.7321"),
    "Octave dare": Printed(
        dlqr, pose("0.4 1.7; 0.9 3.8", "0.8; 2.1", "1 -1; -1 1", 3), "0.4092 1.7283",
        "1.5354 1.2623; 1.2623 10.5596", "-0.0022 0.2454",
    ),
    # SLICOT 5.8, example programs
    "SLICOT SB02ND": Printed(
        dlqr, pose("2 -1; 1 0", "1; 0", "0 0; 0 1", 0), "2.0000 -1.0000", "1.0000 0.0000; 0.0000 1.0000"
    ),
    "SLICOT SG02ND": Printed(dlqr, pose("2 -1; 1 0", "1; 0", "0 0; 0 1", 0, E="1 0; 0 1"), "2.0000 -1.0000"),
    "SLICOT SG02AD": Printed(lqr, pose(*INTEGRATORS, 1, 1, E="1 0; 0 1"), "", "1.7321 1.0000; 1.0000 1.7321"),
    "SLICOT SB02RD": Printed(lqr, pose(*INTEGRATORS, "1 0; 0 2", 1), "", "2.0000 1.0000; 1.0000 2.0000"),
    # MATLAB, reference pages of lqr, idare and icare
    "MATLAB lqr": Printed(
        lqr, pose(*CART, "1 0 0 0; 0 0 0 0; 0 0 1 0; 0 0 0 0", 1), "-1.0000 -1.7559 16.9145 3.2274",
        "1.5346 1.2127 -3.2274 -0.6851; 1.2127 1.5321 -4.5626 -0.9640; -3.2274 -4.5626 26.5487 5.2079; "
        "-0.6851 -0.9640 5.2079 1.0311",
        "-0.8684+0.8523j -0.8684-0.8523j -5.4941+0.4564j -5.4941-0.4564j",
    ),
    "MATLAB idare": Printed(
        dlqr, pose("-0.9 -0.3; 0.7 0.1", "1; 1", "1 0; 0 3", 0.1), "-0.2216 -0.1297",
        "4.7687 0.9438; 0.9438 3.2369", "-0.4460 -0.0027",
    ),
    "MATLAB icare": Printed(
        lqr, pose("-1 2 3; 4 5 -6; 7 -8 9", "5; 6; -7", "49 -56 63; -56 64 -72; 63 -72 81", 1), "",
        "15.3201 4.2369 17.0090; 4.2369 2.6252 4.4123; 17.0090 4.4123 19.0374", "-3.2139 -10.1191 -76.9693",
    ),
    "MATLAB Answers 2100091": Printed(lqr, pose(*INTEGRATORS, "1 0; 0 2", 1), "1.0000 2.0000"),
    # Control Tutorials for MATLAB and Simulink (CTMS), University of Michigan
    "CTMS pitch, p = 2": Printed(lqr, pose(*AIRCRAFT, "0 0 0; 0 0 0; 0 0 2", 1), "-0.5034 52.8645 1.4142"),
    "CTMS pitch, p = 50": Printed(lqr, pose(*AIRCRAFT, "0 0 0; 0 0 0; 0 0 50", 1), "-0.6435 169.6950 7.0711"),
    "CTMS pendulum": Printed(
        lqr, Example(*pendulum(), np.diag([1.0, 0, 1, 0]), np.eye(1)), "-1.0000 -1.6567 18.6854 3.4594"
    ),
    "CTMS pendulum, weighted": Printed(
        lqr, Example(*pendulum(), np.diag([5000.0, 0, 100, 0]), np.eye(1)), "-70.7107 -37.8345 105.5298 20.9238"
    ),
    # Wolfram, LQRegulatorGains and LQOutputRegulatorGains, with MATLAB's digits of Guazzone's dcsxx-control
    "Wolfram LQRegulatorGains 1": Printed(
        dlqr,
        pose(
            "0.4725 0.2376 0.0589 0.1971; 0.1451 0.5669 0.2311 0.0439; 0.0932 0.1190 0.5752 0.2319; "
            "0.2628 0.0757 0.1406 0.4465", "0.5711; -0.3999; 0.6899; 0.8156",
            "0.5 0 0 0; 0 0.8 0 0; 0 0 2 0; 0 0 0 4", 1,
        ),
        "0.258263408785324 0.130076037449530 0.301712976754135 0.393239174520131",
        "0.820688030019406 0.366157393574175 0.142357177991738 0.230214495860850;"
        "0.366157393574175 1.502565253736899 0.491675367390775 0.233049076800882;"
        "0.142357177991738 0.491675367390775 2.770266171822138 0.158115947330550;"
        "0.230214495860850 0.233049076800882 0.158115947330550 4.285246483933100",
        "0.715676446034849 0.460342919154304 0.130363078014160+0.048280928782719j "
        "0.130363078014160-0.048280928782719j",
    ),
    "Wolfram LQRegulatorGains 2": Printed(
        dlqr, pose("1 1 -2; 0 1 1; 0 0 1", "1; 0; 1", 1, 10), "0.131575602686720 1.015926918639910 1.316503115669289",
        "7.7212408523700 25.4481597239685 -0.1210476586442; 25.4481597239685 118.2679389650807 25.6345692556058;"
        "-0.1210476586442 25.6345692556058 40.2837910468753",
        "0.464520830811466+0.249314173526600j 0.464520830811466-0.249314173526600j 0.622879620021054",
    ),
    "Wolfram LQRegulatorGains 3": Printed(
        dlqr, pose("0.95123 0; 0 0.904838", "4.9 4.9; -0.019 0.009", "0.01 0; 0 100", "2 0; 0 0.5"),
        "0.022043168004973 -3.296571964433571; 0.078004554558866 3.751723555757965",
        "0.0178886938538 -0.1642946262000; -0.1642946262000 373.6813637743126", "0.459187566597895 0.810246213513234",
    ),
    "Wolfram LQRegulatorGains 4": Printed(  # [[Q, N], [N', R]] is indefinite
        dlqr,
        pose(
            "-0.5 0 0; 0 0.9999 0; 0 0 0.8187", "0.185 0.1974; 0.1 0.139; 0.1813 0", "10 0 0; 0 1 0; 0 0 1",
            "0.4 0.1; 0.1 0.1", "1 1; 2 1; 2 1",
        ),
        "-0.10259451927409935 1.0550552116729919 3.3699401712231705;"
        "-0.4714396669727725 0.4206832287681541 -1.796589906583708",
        "13.104637764024423 0.2570942162727292 0.1803474599444;"
        "0.2570942162727292 -2.741491441343835 -6.024514042762959;"
        "0.1803474599444 -6.024514042762959 -4.280531570924603",
        "0.850245380354058 -0.35398128255121586 0.15942743551445882",
    ),
    "Wolfram LQOutputRegulatorGains 1": Printed(
        dlqr,
        of_outputs(
            "-0.05156 -0.058770; 0.01503 -0.005887", "0; -0.03384", "1.1 -0.5; -0.7 1", "0.1; 0.2", "10 0; 0 0.1", "1"
        ),
        "0.972149539638538 -0.442347371188903",
        "11.141022805252103 -5.057580732711166; -5.057580732711166 2.418501386750889",
        "-0.036208017520516+0.050803722152156j -0.036208017520516-0.050803722152156j",
    ),
    "Wolfram LQOutputRegulatorGains 2": Printed(
        dlqr, of_outputs(*COUPLED),
        "-0.5727425667891235 -0.015333480978689376 -0.6509281335164934 -0.005825529959808867;"
        "2.4734966016228954 -0.12406716180484925 4.353453877275993 -0.27783321717671866",
        "6.450086022615284 0.29484190309117786 7.92070501731365 0.3409790812924333;"
        "0.29484190309117786 0.013477610610715578 0.36206582872544446 0.015586601618962546;"
        "7.92070501731365 0.36206582872544446 9.726625001794925 0.4187222791327824;"
        "0.3409790812924333 0.015586601618962546 0.4187222791327824 0.01802560980913717",
        "-0.8240762158433446 -0.5195595835434045 0.27784825088463877 -0.005451100804677363",
    ),
    "jargon dare": Printed(
        dlqr, pose("1 -1 1; 0 1 1; 0 0 1", "1 0; 1 0; 0 1", "10 0 0; 0 1 0; 0 0 0.1", "10 0; 0 0.1"), "",
        "42.2835 -68.5247 -3.94783; -68.5247 154.043 16.0017; -3.94783 16.0017 8.33197",
    ),
    "ControlSystems.jl lqr": Printed(dlqr, pose("1 0.1; 0 1", "0; 1", 1, 1), "0.5890881713787511 0.7118839434795103"),
}  # fmt: skip
PARTS = [(name, part) for name, case in CASES.items() for part in ("K", "S", "poles") if getattr(case, part)]


def allowed(texts: list[str], largest: float) -> np.ndarray:
    """Half a unit of the last digit of every number, its real part where it is complex."""
    exponents = [int(Decimal(REAL.match(text)[0]).as_tuple().exponent) for text in texts]
    return np.array([max(0.501 * 10.0**k, ENOUGH * largest) for k in exponents])


@pytest.mark.parametrize(("name", "part"), PARTS, ids=[f"{name}: {part}" for name, part in PARTS])
def test_printed_regulator(name, part):
    case = CASES[name]
    e = case.problem
    found = dict(zip(("K", "S", "poles"), case.function(e.A, e.B, e.Q, e.R, **options(e)), strict=True))[part]
    texts = getattr(case, part).replace(";", " ").split()
    printed = np.array([complex(text) for text in texts])
    if part == "poles":  # in any order
        found = found[[np.argmin(np.abs(found - p)) for p in printed]]
    off = found.ravel() - printed
    off = np.maximum(np.abs(off.real), np.abs(off.imag))
    assert (off <= allowed(texts, np.abs(printed).max())).all(), off


MATEQN = {  # python-control, mateqn_test.py: it asks for the residual and stability, no numbers
    "care": (lqr, pose("-2 -1; -1 -1", "1 0; 0 4", "0 0; 0 1", 1)),
    "care_g": (lqr, pose("-2 -1; -1 -1", "1 0; 0 4", "0 0; 0 1", "2 0; 0 1", E="2 1; 1 2")),
    "care_g2": (lqr, pose("-2 -1; -1 -1", "1; 0", "0 0; 0 1", 1, "1; 0", "2 1; 1 2")),
    "dare": (dlqr, pose("-0.6 0; -0.1 -0.4", "2 1; 0 1", "2 1; 1 0", 1)),
    "dare, second": (dlqr, pose("1 0; -1 1", "1; 0", "0 1; 1 1", 2)),
    "dare_g": (dlqr, pose("-0.6 0; -0.1 -0.4", "1 5; 2 4", "2 1; 1 3", 1, "1 0; 2 0", "2 1; 1 2")),
    "dare_g2": (dlqr, pose("-0.6 0; -0.1 -0.4", "1; 2", "2 1; 1 3", 1, "1; 2", "2 1; 1 2")),
}


@pytest.mark.parametrize("name", MATEQN)
def test_equations_of_python_control(name):
    function, e = MATEQN[name]
    discrete = function is dlqr
    true = truth(e, discrete=discrete)
    check_regulator(e, *function(e.A, e.B, e.Q, e.R, **options(e)), true, discrete=discrete)


@pytest.mark.parametrize("rho", [1e-4, 1.0, 25.0])
def test_double_integrator_of_bryson_and_ho(rho):
    """K = [rho^-1/2, 2^1/2 rho^-1/4], poles in second-order Butterworth's place. Bryson and Ho (1975), chapter 5."""
    K, S, poles = lqr([[0, 1], [0, 0]], [[0], [1]], np.diag([1, 0]), [[rho]])
    np.testing.assert_allclose(K, [[rho**-0.5, np.sqrt(2) * rho**-0.25]], rtol=1e-13)
    np.testing.assert_allclose(S, [[np.sqrt(2) * rho**0.25, rho**0.5], [rho**0.5, np.sqrt(2) * rho**0.75]], rtol=1e-13)
    np.testing.assert_allclose(np.abs(poles), rho**-0.25, rtol=1e-12)


@pytest.mark.parametrize("rho", [2e-5, 2e-3, 1.0])
def test_position_servo_of_kwakernaak_and_sivan(rho):
    """dx = [0 1; 0 -a] x + [0; k] u, cost x1^2 + rho u^2: K and the poles in closed form, a = 4.6 1/s, k = .787."""
    a, k = 4.6, 0.787
    K, _, poles = lqr([[0, 1], [0, -a]], [[0], [k]], np.diag([1, 0]), [[rho]])
    root = np.sqrt(a * a + 2 * k / np.sqrt(rho))
    np.testing.assert_allclose(K, [[rho**-0.5, (root - a) / k]], rtol=1e-12)
    np.testing.assert_allclose([-poles.sum().real, poles.prod().real], [root, k / np.sqrt(rho)], rtol=1e-12)
