"""CAREX, the benchmark collection of continuous Riccati equations, every example: `EXAMPLES[name]()`.

Numbers are those of version 2.0: group.number, and in the comment the number of the first edition. Parameters are the
defaults of the collection (the extreme ones) and milder ones of the reports.

References: Benner, Laub and Mehrmann (1995), A collection of benchmark examples for the numerical solution of algebraic
Riccati equations I: continuous-time case, SPC 95_22, TU Chemnitz; Abels and Benner (1999), SLICOT Working Note 1999-14.
Data: SLICOT's benchmark_data (BSD-3-Clause), see data/README.md.
"""

from functools import partial

import numpy as np
from riccati_examples import Example, Examples, family, quadratic, reflected, stored

DOUBLE = np.array([[0.0, 1.0], [0.0, 0.0]])
LAST = np.array([[0.0], [1.0]])


def laub_1() -> Example:
    """1: double integrator. Laub (1979), example 1."""
    return Example(DOUBLE, LAST, np.diag([1.0, 2.0]), np.eye(1), X=np.array([[2.0, 1.0], [1.0, 2.0]]))


def laub_2() -> Example:
    """2: a stable mode that is neither controlled nor seen. Laub (1979), example 2."""
    Q = np.array([[9.0, 6.0], [6.0, 4.0]])
    return Example(
        np.array([[4.0, 3.0], [-4.5, -3.5]]), np.array([[1.0], [-1.0]]), Q, np.eye(1), X=(1 + np.sqrt(2)) * Q
    )


def aircraft() -> Example:
    """3: lateral motion of the L-1011. Beale and Shafai (1989)."""
    d = stored("CAREX 1.3")
    return Example(d["A"], d["B"], d["Q"], np.eye(2))


def distillation() -> Example:
    """4: binary distillation column. Bhattacharyya, del Nero Gomes and Howze (1983)."""
    d = stored("CAREX 1.4")
    return Example(d["A"], d["B"], d["Q"], np.eye(2))


def ammonia() -> Example:
    """5: tubular ammonia reactor. Patnaik, Viswanadham and Sarma (1980)."""
    d = stored("CAREX 1.5")
    return Example(d["A"], d["B"], np.eye(9), np.eye(3))


def jet_engine() -> Example:
    """6: J-100 jet engine. Davison and Gesing (1978)."""
    d = stored("CAREX 1.6")
    return Example(d["A"], d["B"], quadratic(d["C"]), np.eye(3))


def hardly_stabilisable(e: float) -> Example:
    """7: Arnold and Laub (1984), example 1."""
    root = np.hypot(1, e)
    off = 1 / (2 + root)
    X = np.array([[(1 + root) / e**2, off], [off, (1 - e * off) * (1 + e * off) / 4]])
    return Example(np.diag([1.0, -2.0]), np.array([[e], [0.0]]), np.ones((2, 2)), np.eye(1), X=X, parameters={"e": e})


def nearly_free_command(e: float) -> Example:
    """8: R is nearly singular. Arnold and Laub (1984), example 3."""
    B, C = np.array([[0.1, 0.0], [0.001, 0.01]]), np.array([[10.0, 100.0]])
    return Example(np.diag([-0.1, -0.02]), B, quadratic(C), np.array([[1 + e, 1], [1, 1]]), parameters={"e": e})


def scaled_integrators(e: float) -> Example:
    """9: Kenney, Laub and Wette (1989), example 2."""
    root = np.sqrt(1 + 2 * e)
    X = np.array([[root / e, 1.0], [1.0, root]])
    return Example(e * DOUBLE, LAST, np.eye(2), np.eye(1), X=X, parameters={"e": e})


def twin_modes(e: float) -> Example:
    """10: ill-conditioned Hamiltonian. Bai and Qian (1994)."""
    a = e + 1
    x = (2 * a + np.sqrt(2) * (np.hypot(a, 1) + e)) / 2
    X = np.array([[x, x / (x - a)], [x / (x - a), x]])
    return Example(np.array([[a, 1], [1, a]]), np.eye(2), e**2 * np.eye(2), np.eye(2), X=X, parameters={"e": e})


def hinfinity(e: float) -> Example:
    """11: indefinite Q, closed loop at -e +- i. Laub (1992). At e = 0 no solution stabilises."""
    A, Q = np.array([[3 - e, 1], [4, 2 - e]]), np.array([[4 * e - 11, 2 * e - 5], [2 * e - 5, 2 * e - 2]])
    X = np.array([[2.0, 1.0], [1.0, 1.0]])
    return Example(A, np.ones((2, 1)), Q, np.eye(1), X=X, parameters={"e": e}, solvable=e > 0)


def badly_scaled(e: float) -> Example:
    """12: Petkov, Christov and Konstantinov (1987)."""
    s = e * e
    x = [s + np.hypot(s, 1), 2 * s + np.sqrt(4 * s**2 + e), 3 * s + e * np.sqrt(9 * s + 1)]
    Q = reflected([1 / e, 1, e])
    return Example(reflected([e, 2 * e, 3 * e]), np.eye(3), Q, e * np.eye(3), X=reflected(x), parameters={"e": e})


def tape_drive(e: float, *, descriptor: bool = False) -> Example:
    """13: fast and slow modes of a magnetic tape drive. Chow and Kokotovic (1976)."""
    A = np.array([[0, 0.4, 0, 0], [0, 0, 0.345, 0], [0, -0.524, -0.465, 0.262], [0, 0, 0, -1]])
    B, E = np.eye(4)[:, 3:], np.diag([1, 1, e, e])
    Q, R = np.diag([1.0, 0, 1, 0]), np.eye(1)
    if descriptor:
        return Example(A, B, Q, R, E=E, parameters={"e": e})
    return Example(A / np.diag(E)[:, None], B / e, Q, R, parameters={"e": e})


def poorly_separated(e: float) -> Example:
    """14: closed-loop modes near the axis. Arnold and Laub (1984), example 2."""
    S = np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.block([[S - e * np.eye(2), np.zeros((2, 2))], [np.zeros((2, 2)), S + e * np.eye(2)]])
    return Example(A, np.ones((4, 1)), np.ones((4, 4)), np.eye(1), parameters={"e": e})


def flutter(*, estimator: bool) -> Example:
    """2.9: Boeing 767 at flutter, regulator and filter. IFAC benchmark problem 90-06 (Davison 1990)."""
    d = stored("CAREX 2.9")
    if estimator:
        D, V = d["disturbances"], np.diag([28224.0, 2.742e-5, 6.854e-4])
        return Example(d["A"].T, d["sensors"], quadratic(D, V), np.diag([6.85e-6, 373.0]))
    W = np.diag([0, 0.376e-13, 0.12e-12, 0, 0, 0.245e-11, 0, 0, 0, 0])
    return Example(d["A"], d["B"], quadratic(d["C"], W), np.diag([364.7, 14.59]))


def vehicles(count: int) -> Example:
    """15: string of high-speed vehicles, speeds and gaps in turn. Laub (1979), example 4."""
    n = 2 * count - 1
    A = np.zeros((n, n))
    speeds, gaps = np.arange(0, n, 2), np.arange(1, n, 2)
    A[speeds, speeds], A[gaps, gaps - 1], A[gaps, gaps + 1] = -1, 1, -1
    B, Q = np.zeros((n, count)), np.zeros((n, n))
    B[speeds, np.arange(count)], Q[gaps, gaps] = 1, 10
    return Example(A, B, Q, np.eye(count), parameters={"vehicles": count})


def circulant(n: int) -> Example:
    """16: Laub (1979), example 5."""
    I = np.eye(n)
    A = np.roll(I, 1, 0) + np.roll(I, -1, 0) - 2 * I
    a = -2 + 2 * np.cos(2 * np.pi * np.arange(n) / n)  # the eigenvalues of A
    angles = 2 * np.pi * np.outer(np.arange(n), np.arange(n)) % (2 * np.pi * n) / n
    row = np.cos(angles) @ (a + np.sqrt(a * a + 1)) / n
    i = np.arange(n)
    return Example(A, I, I, I, X=row[np.abs(i[:, None] - i)], parameters={"n": n})


def integrators(n: int, q: float, r: float) -> Example:
    """17: chain of integrators, X[0, -1] = sqrt(q r). Laub (1979), example 6."""
    Q = np.zeros((n, n))
    Q[0, 0] = q
    return Example(np.eye(n, k=1), np.eye(n)[:, -1:], Q, r * np.eye(1), parameters={"n": n, "q": q, "r": r})


def heat(n: int, *, descriptor: bool = False, a=0.01, b=1.0, c=1.0, beta=(0.2, 0.3), gamma=(0.2, 0.3)) -> Example:
    """18: heat flow in a rod, linear elements. Rosen and Wang (1992)."""
    h, i = 1 / (n + 1), np.arange(1, n + 1)
    mass = h * (4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) / 6
    stiffness = a / h * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n))

    def part(interval) -> np.ndarray:
        """Integral of every hat function over an interval."""
        s = np.clip([[x / h - i] for x in interval], -1, 1)[:, 0]
        below = h * np.where(s < 0, (1 + s) ** 2 / 2, 1 - (1 - s) ** 2 / 2)
        return below[1] - below[0]

    B, C = b * part(beta)[:, None], c * part(gamma)[None]
    parameters = {"n": n, "a": a, "b": b, "c": c}
    if descriptor:
        return Example(stiffness, B, quadratic(C), np.eye(1), E=mass, parameters=parameters)
    A, B = np.linalg.solve(mass, stiffness), np.linalg.solve(mass, B)
    return Example(A, B, quadratic(C), np.eye(1), parameters=parameters)


def springs(count: int, *, descriptor: bool = False, mass=4.0, damper=4.0, spring=1.0) -> Example:
    """19: masses, springs and dampers in a row, forces at both ends. Hench, He, Kucera and Mehrmann (1995)."""
    O, I = np.zeros((count, count)), np.eye(count)
    K = spring * (np.eye(count, k=1) + np.eye(count, k=-1) - 2 * I)
    K[0, 0] = K[-1, -1] = -spring
    B = np.zeros((2 * count, 2))
    B[count, 0], B[-1, 1] = 1, -1
    m = np.repeat([1.0, mass], count)
    A = np.block([[O, I], [K, -damper * I]])
    parameters = {"masses": count, "mass": mass, "damper": damper, "spring": spring}
    if descriptor:
        return Example(A, B, np.eye(2 * count), np.eye(2), E=np.diag(m), parameters=parameters)
    return Example(A / m[:, None], B / m[:, None], np.eye(2 * count), np.eye(2), parameters=parameters)


def axle() -> Example:
    """20: rotating axle of a turbine: first speed, differences of speed, of angle. Lang and Penzl (1994)."""
    d = stored("CAREX 4.4")
    inertia, ground, damping, stiffness = d["inertia"], d["damping_to_ground"], d["damping"], d["stiffness"]
    n = len(inertia)
    T = np.eye(n, k=-1) - np.eye(n)  # differences w_(i-1) - w_i of the speeds, but for
    T[0, 0] = 1  # the first speed itself
    speeds = np.linalg.inv(T)
    B = T / inertia
    between = np.hstack([np.zeros((n - 1, 1)), np.eye(n - 1)])
    coupling = B @ T[1:].T
    A = np.block([
        [-T @ (speeds * (ground / inertia)[:, None]) - coupling * damping @ between, -coupling * stiffness],
        [between, np.zeros((n - 1, n - 1))],
    ])  # fmt: skip
    C = np.zeros((n, 2 * n - 1))
    C[0, 0] = 1
    C[1:, 1:n], C[1:, n:] = np.diag(damping), np.diag(stiffness)
    C[1:] /= np.hypot(damping, stiffness)[:, None]
    return Example(A, np.vstack([B, np.zeros((n - 1, n))]), quadratic(C), np.eye(n))


EXAMPLES: Examples = {
    "1.1": laub_1,
    "1.2": laub_2,
    "1.3": aircraft,
    "1.4": distillation,
    "1.5": ammonia,
    "1.6": jet_engine,
    **family("2.1", hardly_stabilisable, "e", (1.0, 1e-3, 1e-6)),
    **family("2.2", nearly_free_command, "e", (1.0, 1e-4, 1e-8)),
    **family("2.3", scaled_integrators, "e", (1.0, 1e3, 1e6, 1e-6)),
    **family("2.4", twin_modes, "e", (1.0, 1e-5, 1e-7)),
    **family("2.5", hinfinity, "e", (1.0, 1e-4, 0.0)),
    **family("2.6", badly_scaled, "e", (1.0, 1e2, 1e4, 1e6)),
    **family("2.7", tape_drive, "e", (1.0, 1e-3, 1e-6)),
    **family("2.7 descriptor", partial(tape_drive, descriptor=True), "e", (1.0, 1e-6)),
    **family("2.8", poorly_separated, "e", (1.0, 1e-3, 1e-6)),
    "2.9 regulator": partial(flutter, estimator=False),
    "2.9 filter": partial(flutter, estimator=True),
    **family("3.1", vehicles, "vehicles", (5, 20)),
    **family("3.2", circulant, "n", (8, 64)),
    "4.1, n = 6": partial(integrators, 6, 1.0, 1.0),
    "4.1, n = 21": partial(integrators, 21, 1.0, 1.0),
    "4.1, n = 21, q = r = 100": partial(integrators, 21, 100.0, 100.0),
    **family("4.2", heat, "n", (10, 100)),
    "4.2 descriptor, n = 10": partial(heat, 10, descriptor=True),
    **family("4.3", springs, "masses", (5, 30)),
    "4.3 descriptor, masses = 5": partial(springs, 5, descriptor=True),
    "4.4": axle,
}
