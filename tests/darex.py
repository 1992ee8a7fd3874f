"""DAREX, the benchmark collection of discrete Riccati equations, every example: `EXAMPLES[name]()`.

References: Benner, Laub and Mehrmann (1995), A collection of benchmark examples for the numerical solution of algebraic
Riccati equations II: discrete-time case, SPC 95_23, TU Chemnitz; Abels and Benner (1999), SLICOT Working Note 1999-16
(version 2.0, whose numbers these are). Data: SLICOT's benchmark_data (BSD-3-Clause), see data/README.md.
"""

import numpy as np
from riccati_examples import Example, Examples, family, quadratic, reflected, stored, symmetric


def free_command() -> Example:
    """R = 0. Van Dooren (1981), example II."""
    A, B = np.array([[2.0, -1.0], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    return Example(A, B, np.diag([0.0, 1.0]), np.zeros((1, 1)), X=np.eye(2))


def cross_weight() -> Example:
    """Singular R, indefinite [[Q, N], [N', R]]. Ionescu and Weiss (1992)."""
    A, B = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[1.0, 0.0], [2.0, 1.0]])
    Q, R = np.array([[-4.0, -4.0], [-4.0, 7.0]]) / 11, np.array([[9.0, 3.0], [3.0, 1.0]])
    return Example(A, B, Q, R, N=np.array([[3.0, 1.0], [-1.0, 7.0]]), bounded=False)


def jonckheere() -> Example:
    """Jonckheere (1981): controllable, no solution is negative semidefinite."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    Q, X = np.array([[1.0, 2.0], [2.0, 4.0]]), np.array([[1.0, 2.0], [2.0, 2 + np.sqrt(5)]])
    return Example(A, B, Q, np.eye(1), X=X)


def indefinite(a: float) -> Example:
    """Singular R, indefinite Q. Sun (1998). BB02AD has a = 0.01 but the solution of a = 0.1, whose last entry is 0."""
    A, B = np.diag([0.1, a], 1), np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    X = np.diag([1e5, 1e3, 1e3 * a**2 - 10])
    return Example(A, B, np.diag([1e5, 1e3, -10.0]), np.diag([0.0, 1.0]), X=X, parameters={"a": a}, bounded=a > 0.09)


def satellite() -> Example:
    """Ackerson and Fu (1970)."""
    d = stored("DAREX 1.5")
    Q = symmetric(4, q11=1.87, q41=-0.244, q22=0.744, q32=0.205, q33=0.589, q44=1.048)
    return Example(d["A"], d["B"], Q, np.eye(2))


def slow_and_fast() -> Example:
    """Litkouhi (1983)."""
    d = stored("DAREX 1.6")
    return Example(d["A"], d["B"], 0.01 * np.eye(4), np.eye(2))


def lu_lin() -> Example:
    """Lu and Lin (1993), example 4.3."""
    d = stored("DAREX 1.7")
    C = np.array([[1.0, 1, 2, 4], [0, 1, 1, 2], [0, 0, 1, 1], [0, 0, 0, 1]])
    W = symmetric(4, q11=2, q21=-1, q22=2, q32=-1, q33=2)
    return Example(d["A"], d["B"], quadratic(C, W), np.eye(4))


def chemical_plant() -> Example:
    """Gajic and Shen (1993), section 2.7.4."""
    d = stored("DAREX 1.8")
    return Example(d["A"], d["B"], np.eye(5), np.eye(2))


def davison_wang() -> Example:
    """Davison and Wang (1974), with a cross weight."""
    shift = np.eye(3, k=1)
    A = np.block([[shift, np.zeros((3, 3))], [np.zeros((3, 3)), shift]])
    C, B, N = np.zeros((2, 6)), np.zeros((6, 2)), np.zeros((6, 2))
    C[0, :2], C[1, 3:5], B[2, 0], B[5, 1] = 1, [1, -1], 1, 1
    N[:, 0] = C[0] + C[1]
    return Example(A, B, quadratic(C), np.diag([3.0, 1.0]), N=N)


def ammonia() -> Example:
    """Tubular ammonia reactor, sampled. Patnaik, Viswanadham and Sarma (1980)."""
    d = stored("DAREX 1.10")
    Q = np.zeros((9, 9))
    Q[0, 0] = Q[4, 4] = 50
    return Example(d["A"], d["B"], Q, np.eye(3))


PAPER_MACHINE = np.diag([0.5, 5.0, 0.5, 5.0]), np.diag([400.0, 700.0])


def paper_machine_errors() -> Example:
    """Paper machine, integrators of the model error. Sima (1996), section 1.2.2."""
    d, (W, R) = stored("DAREX 1.11"), PAPER_MACHINE
    C = np.zeros((4, 11))
    C[0, 5], C[1, 6:9], C[2, 9], C[3, 10] = 15, [7, -5.357, -3.943], 1, 1
    A = d["A"]
    A[9, 9] = A[10, 10] = 1
    return Example(A, d["B"], quadratic(C, W), R)


def paper_machine_disturbed() -> Example:
    """Paper machine with disturbances. Sima (1996), example 2.6."""
    W, R = PAPER_MACHINE
    A, B, C = np.eye(13, k=1), np.zeros((13, 2)), np.zeros((4, 13))
    A[10:] = 0
    A[5, 6] = A[7, 8] = 0
    A[5, 5], A[7, 6], A[7, 7], A[10, 10], A[11, 11], A[12, 12] = 0.7788, -0.4724, 1.3746, 0.8071, 1, 1
    C[0, 0], C[1, 0], C[1, 6:9] = 3.318, 1.5484, [-0.3981, -0.5113, -5.7865]
    C[2, 11] = C[3, 12] = B[5, 0] = B[7, 1] = 1
    A[11:, :11] = -C[:2, :11]
    return Example(A, B, quadratic(C, W), R)


def power_plant() -> Example:
    """Power plant with integrated outputs. Katayama, Itoh, Ogawa and Yamamoto (1985)."""
    d = stored("DAREX 1.13")
    A = np.block([[d["A"], np.zeros((20, 6))], [-d["C"], np.eye(6)]])
    return Example(A, np.vstack([d["B"], np.zeros((6, 6))]), np.diag([*np.zeros(20), *d["q"]]), np.diag(d["r"]))


def laub_2(r: float) -> Example:
    """A mode that is neither controlled nor seen. Laub (1979), example 2."""
    Q = np.array([[9.0, 6.0], [6.0, 4.0]])
    A, B = np.array([[4.0, 3.0], [-4.5, -3.5]]), np.array([[1.0], [-1.0]])
    return Example(A, B, Q, r * np.eye(1), X=(1 + np.sqrt(1 + 4 * r)) / 2 * Q, parameters={"r": r})


def laub_3(e: float) -> Example:
    """Ill-conditioned R. Laub (1979), example 3."""
    A, B = np.diag([0.9512, 0.9048]), np.array([[4.877, 4.877], [-1.1895, 3.569]])
    return Example(A, B, np.diag([0.005, 0.02]), np.diag([1 / (3 * e), 3 * e]), parameters={"e": e})


def scaled_delays(e: float) -> Example:
    """Badly scaled as e grows."""
    A, B = np.array([[0.0, e], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    return Example(A, B, np.eye(2), np.eye(1), X=np.diag([1.0, 1 + e * e]), parameters={"e": e})


def badly_scaled(e: float) -> Example:
    """Petkov, Christov and Konstantinov (1989)."""
    X = reflected([e, e * (1 + np.sqrt(5)) / 2, e * (9 + np.sqrt(85)) / 2])
    return Example(reflected([0, 1, 3]), np.eye(3), e * np.eye(3), e * np.eye(3), X=X, parameters={"e": e})


def dead_time(tau: float, d=1.0, k=1.0, r=0.25) -> Example:
    """Lag of a time constant tau behind a dead time, paper machine. Pappas, Laub and Sandell (1980)."""
    a, b = 1 - d / tau, k * d / tau
    A = np.eye(4, k=-1)
    A[0, 0] = a
    p = r * (a + 1) * (a - 1) + b * b
    X = np.diag([(p + np.sqrt(p * p + 4 * b * b * r)) / (2 * b * b), 1, 1, 1])
    return Example(A, b * np.eye(4)[:, :1], np.diag([0.0, 0, 0, 1]), r * np.eye(1), X=X, parameters={"tau": tau})


def delays(n: int) -> Example:
    """Chain of delays. Pappas, Laub and Sandell (1980), example 3."""
    X = np.diag(np.arange(1.0, n + 1))
    return Example(np.eye(n, k=1), np.eye(n)[:, -1:], np.eye(n), np.eye(1), X=X, parameters={"n": n})


EXAMPLES: Examples = {
    "1.1": free_command,
    "1.2": cross_weight,
    "1.3": jonckheere,
    **family("1.4", indefinite, "a", (0.01, 0.1)),
    "1.5": satellite,
    "1.6": slow_and_fast,
    "1.7": lu_lin,
    "1.8": chemical_plant,
    "1.9": davison_wang,
    "1.10": ammonia,
    "1.11": paper_machine_errors,
    "1.12": paper_machine_disturbed,
    "1.13": power_plant,
    **family("2.1", laub_2, "r", (1.0, 1e6)),
    **family("2.2", laub_3, "e", (1.0, 1e6)),
    **family("2.3", scaled_delays, "e", (1.0, 1e3, 1e6)),
    **family("2.4", badly_scaled, "e", (1.0, 1e6)),
    **family("2.5", dead_time, "tau", (10.0, 1e4, 1e8)),
    **family("4.1", delays, "n", (10, 100)),
}
