"""The generalised plant of H-infinity theory: nine matrices with named channels.

    x+ = A  x + B1  w + B2  u        w exogenous inputs, u actuator inputs
    z  = C1 x + D11 w + D12 u        z regulated outputs, y sensed outputs
    y  = C2 x + D21 w + D22 u        closed by u = K y (positive feedback)

Reference: Pecorilla and Stesina (2024), doi 10.1002/rnc.7119, equations (22) to (27); the signs of (26) are
those of (27).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from synth.checks import (
    as_array,
    as_matrix,
    as_names,
    as_number,
    as_texts,
    as_timebase,
    as_units,
    as_weight,
    as_whole,
    restore,
    shown,
)
from synth.errors import ModelError
from synth.systems.connect import lft, series
from synth.systems.statespace import StateSpace, as_system, as_systems, common_timebase, repeated


@dataclass(frozen=True, eq=False)
class GeneralizedPlant:
    """Nine matrices and a timebase; checked when made.

    Channel names are optional: empty tuples are filled with w0, w1, ..., z0, ..., u0, ..., y0, ...

    Raises
    ------
    ModelError : shapes do not fit, an entry is not finite, a channel name is missing or doubled.
    """

    A: np.ndarray  # (n, n)
    B1: np.ndarray  # (n, nw)
    B2: np.ndarray  # (n, nu)
    C1: np.ndarray  # (nz, n)
    D11: np.ndarray  # (nz, nw)
    D12: np.ndarray  # (nz, nu)
    C2: np.ndarray  # (ny, n)
    D21: np.ndarray  # (ny, nw)
    D22: np.ndarray  # (ny, nu)
    dt: float = 0.0  # s, 0 for continuous time
    w: tuple[str, ...] = ()  # (nw) names
    u: tuple[str, ...] = ()  # (nu) names
    z: tuple[str, ...] = ()  # (nz) names
    y: tuple[str, ...] = ()  # (ny) names
    units: Mapping[str, str] = field(default_factory=dict)  # channel name -> unit, for exported files
    continuous: GeneralizedPlant | None = None  # the plant that `c2d` sampled: what is between the samples
    delay: float = 0.0  # s, from the sample to the new value of the hold, in that plant
    held: tuple[str, ...] = ()  # those of its w that are constant over a period, beside those that reach y directly
    __setstate__ = restore

    def __post_init__(self):
        D11, D22 = as_matrix("D11", self.D11), as_matrix("D22", self.D22)
        (nz, nw), (ny, nu) = D11.shape, D22.shape
        if 0 in (nz, nw, ny, nu):
            raise ModelError(
                f"the plant has nw, nu, nz, ny = {nw}, {nu}, {nz}, {ny}; every channel needs at least one signal"
            )
        A = as_array("A", self.A, "pass a real matrix")
        n = len(as_matrix("A", A)) if A.size else 0
        shapes = {"A": (n, n), "B1": (n, nw), "B2": (n, nu), "C1": (nz, n), "D11": (nz, nw)}
        shapes |= {"D12": (nz, nu), "C2": (ny, n), "D21": (ny, nw), "D22": (ny, nu)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if 0 in shape and as_array(name, value).size:
                raise ModelError(f"{name} has entries but A has none; pass the states' matrix A")
            M = np.zeros(shape) if 0 in shape else as_matrix(name, value, shape)
            M.flags.writeable = False
            object.__setattr__(self, name, M)
        object.__setattr__(self, "dt", as_timebase(self.dt))
        for channel, size in {"w": nw, "u": nu, "z": nz, "y": ny}.items():
            object.__setattr__(
                self, channel, as_names(channel, getattr(self, channel), size, f"channel {channel} has names")
            )
        unknown = set(as_units(self.units)) - {*self.w, *self.u, *self.z, *self.y}
        if unknown:
            raise ModelError(f"units are given for {sorted(unknown)}, which are no channels of the plant")
        object.__setattr__(self, "units", dict(self.units))
        origin = self.continuous
        if origin is not None and not (isinstance(origin, GeneralizedPlant) and origin.dt == 0 and self.dt > 0):
            raise ModelError(
                f"continuous is {shown(origin)}; it is the continuous GeneralizedPlant that a discrete one was sampled "
                "from, which c2d sets: leave it away"
            )
        told = "the time in s from the sample to the new value of the hold, of a plant with `continuous`"
        object.__setattr__(self, "delay", as_number("delay", self.delay, told, least=0))
        object.__setattr__(self, "held", as_texts("held", self.held))
        if unknown := sorted({*self.held} - {*self.w}):
            raise ModelError(f"held is {shown(self.held)}, and {', '.join(unknown)} is no w of the plant")
        if origin is None and (self.delay or self.held):
            raise ModelError(
                "delay and held are about what is between the samples of a plant that has `continuous`; the delays of "
                "a plant of its own are states: see c2d and input_delay"
            )

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """(n, nw, nu, nz, ny)."""
        return (self.A.shape[0], self.B1.shape[1], self.B2.shape[1], self.C1.shape[0], self.C2.shape[0])

    @property
    def system(self) -> StateSpace:
        """The plant as one system from (w, u) to (z, y)."""
        D = np.block([[self.D11, self.D12], [self.D21, self.D22]])
        B, C = np.hstack([self.B1, self.B2]), np.vstack([self.C1, self.C2])
        u, y = (*self.w, *self.u), (*self.z, *self.y)
        if len(set(u)) < len(u) or len(set(y)) < len(y):  # a name may serve a w and a u
            return StateSpace(self.A, B, C, D, self.dt)
        return StateSpace(self.A, B, C, D, self.dt, u, y, self.units)

    @classmethod
    def partition(cls, system: Any, nmeas: int, ncon: int) -> GeneralizedPlant:
        """Split a system whose last `nmeas` outputs are y and last `ncon` inputs are u."""
        G = as_system("P", system)
        if G.ny < 2 or G.nu < 2:
            raise ModelError(
                f"P is {G.ny} x {G.nu}; a generalised plant has at least one w and one u among its inputs, one z and "
                "one y among its outputs. For a plain plant from u to y see mixsyn, ncfsyn, augw and "
                "GeneralizedPlant.tracking"
            )
        for name, value, total in (("nmeas", nmeas, G.ny), ("ncon", ncon, G.nu)):
            as_whole(name, value, f"an integer from 1 to {total - 1} (P has {total})", least=1, most=total - 1)
        m, p = G.nu - int(ncon), G.ny - int(nmeas)
        C, D = (G.C[:p], G.C[p:]), (G.D[:p], G.D[p:])
        u, y = (() if names == as_names(key, (), len(names)) else names for key, names in (("u", G.u), ("y", G.y)))
        return cls(
            A=G.A, B1=G.B[:, :m], B2=G.B[:, m:],
            C1=C[0], D11=D[0][:, :m], D12=D[0][:, m:],
            C2=C[1], D21=D[1][:, :m], D22=D[1][:, m:], dt=G.dt,
            w=u[:m], u=u[m:], z=y[:p], y=y[p:], units=G.units if u and y else {},
        )  # fmt: skip

    @classmethod
    def tracking(cls, P0: Any, *, Wproc, Wdist, Werr, Wact, Wr, u=(), y=(), units=None) -> GeneralizedPlant:
        """Tracking framework, seed equation (27): y = Wr r - P0 (Wp n + u) - Wd d.

        Parameters
        ----------
        P0 : nominal plant with m inputs and q outputs, in any form that `system` takes
        Wproc : (m, m) process noise; Wdist : (q, q) sensor noise; Werr : (q, q) tracking error
        Wact : (m, m) control effort; Wr : (q, q) reference. Each is a number (that multiple of the identity), a list (a
            diagonal), a matrix, or a stable system, of one channel for every signal or of all: integral action in Werr,
            roll-off in Wact, the spectrum of a disturbance
        u, y : names of the m inputs and q outputs, those of P0 when left out
        units : unit of each name in u and y, optional; the derived channels inherit them

        Reference: Pecorilla and Stesina (2024), equation (27).
        """
        G = as_system("P0", P0)
        m, q = G.nu, G.ny
        (Wp, proc), (Wa, act) = _weight("Wproc", Wproc, m, G.dt), _weight("Wact", Wact, m, G.dt)
        Wd, dist = _weight("Wdist", Wdist, q, G.dt)
        (We, err), (Wr, ref) = _weight("Werr", Werr, q, G.dt), _weight("Wr", Wr, q, G.dt)
        O = np.zeros
        u, y = as_texts("u", u) or G.u, as_texts("y", y) or G.y
        units = G.units if units is None else as_units(units)
        plant = cls(
            A=G.A,
            B1=np.hstack([O((G.n, q)), G.B @ Wp, O((G.n, q))]),
            B2=G.B,
            C1=np.vstack([-We @ G.C, O((m, G.n))]),
            D11=np.block([[We @ Wr, -We @ G.D @ Wp, O((q, q))], [O((m, q)), O((m, m)), O((m, q))]]),
            D12=np.vstack([-We @ G.D, Wa]),
            C2=-G.C,
            D21=np.hstack([Wr, -G.D @ Wp, -Wd]),
            D22=-G.D,
            dt=G.dt,
            w=(*(f"reference {s}" for s in y), *(f"process {s}" for s in u), *(f"noise {s}" for s in y)),
            u=u,
            z=(*(f"weighted error {s}" for s in y), *(f"weighted effort {s}" for s in u)),
            y=tuple(f"error {s}" for s in y),
            units={s: units[s] for s in u if s in units} | {f"error {s}": units[s] for s in y if s in units},
        )  # fmt: skip
        weights: dict[str, Any] = {"Wproc": Wproc, "Wdist": Wdist, "Werr": Werr, "Wact": Wact, "Wr": Wr}
        return remembering(
            plant.weighted(w=(ref, proc, dist), z=(err, act)), G, lambda H: cls.tracking(H, **weights, u=u, y=y)
        )

    @classmethod
    def four_block(cls, G: Any, *, Wdist, Wnoise, Wout, Wact) -> GeneralizedPlant:
        """Regular four-block problem: z = [Wout G (u + Wdist d); Wact u] from w = [d; n].

        d is a disturbance at the plant's input, n noise at its output; the measurement is the error against zero,
        y = -(G (u + Wdist d) + Wnoise n), so that K is used as it is with e = r - y. For square, invertible Wnoise and
        Wact the problem is regular also where G has poles on the stability boundary.

        Parameters
        ----------
        G : (q x m) plant, in any form that `system` takes
        Wdist : (m, m) input disturbance; Wnoise : (q, q) output noise
        Wout : (q, q) output; Wact : (m, m) control effort; numbers, lists and systems as in `tracking`

        Reference: Zhou, Doyle and Glover (1996), Robust and Optimal Control, section 16.1.
        """
        G = as_system("G", G)
        m, q = G.nu, G.ny
        (Wd, dist), (Wn, noise), (Wy, out), (Wu, act) = (
            _weight(name, W, size, G.dt)
            for name, W, size in (("Wdist", Wdist, m), ("Wnoise", Wnoise, q), ("Wout", Wout, q), ("Wact", Wact, m))
        )
        O, ins, outs = np.zeros, G.named_inputs, G.named_outputs
        plant = cls(
            A=G.A,
            B1=np.hstack([G.B @ Wd, O((G.n, q))]),
            B2=G.B,
            C1=np.vstack([Wy @ G.C, O((m, G.n))]),
            D11=np.block([[Wy @ G.D @ Wd, O((q, q))], [O((m, m)), O((m, q))]]),
            D12=np.vstack([Wy @ G.D, Wu]),
            C2=-G.C,
            D21=np.hstack([-G.D @ Wd, -Wn]),
            D22=-G.D,
            dt=G.dt,
            w=(*(f"disturbance {s}" for s in ins), *(f"noise {s}" for s in outs)),
            u=G.u,
            z=(*(f"weighted output {s}" for s in outs), *(f"weighted effort {s}" for s in ins)),
            y=tuple(f"error {s}" for s in outs),
            units={s: G.units[s] for s in G.u if s in G.units},
        )
        weights: dict[str, Any] = {"Wdist": Wdist, "Wnoise": Wnoise, "Wout": Wout, "Wact": Wact}
        return remembering(plant.weighted(w=(dist, noise), z=(out, act)), G, lambda H: cls.four_block(H, **weights))

    def weighted(self, *, w: Sequence[StateSpace], z: Sequence[StateSpace]) -> GeneralizedPlant:
        """The plant with systems in front of its w and behind its z, one after the other along the channels.

        Gains of the identity change nothing. Names of channels stay.

        Raises
        ------
        ModelError : the systems have not as many signals as the plant has w or z.
        """
        if not any(W.n for W in (*w, *z)):
            return self
        _, _, nu, _, ny = self.sizes
        before, after = (beside([*weights, StateSpace.gain(np.eye(k), self.dt)]) for weights, k in ((w, nu), (z, ny)))
        bare = StateSpace(*self.system.matrices, self.dt)
        moved = GeneralizedPlant.partition(series(series(before, bare), after), ny, nu)
        return replace(moved, w=self.w, u=self.u, z=self.z, y=self.y, units=self.units)

    def close(self, K: Any) -> StateSpace:
        """Closed loop from w to z under u = K y (positive feedback), K in any form that `system` takes."""
        return lft(self.system, K, self.C2.shape[0], self.B2.shape[1])


def remembering(
    P: GeneralizedPlant, G: StateSpace, build: Callable[[StateSpace], GeneralizedPlant]
) -> GeneralizedPlant:
    """What was built from G; where `c2d` sampled G, with what is built from the continuous system likewise.

    Weights that are gains are the same at all times. A discrete one says nothing of what is between the samples, and
    then nothing is remembered.
    """
    if G.continuous is None or not G.discrete:
        return P
    try:
        return replace(P, continuous=build(G.continuous))
    except ModelError:  # a weight with another timebase
        return P


def _weight(name: str, W: Any, size: int, dt: float) -> tuple[np.ndarray, StateSpace]:
    """A constant weight as a matrix and a gain of one; a dynamic one as the identity and the system itself."""
    I = np.eye(size)
    if np.isscalar(W) or isinstance(W, list | np.ndarray):
        return as_weight(name, W, size), StateSpace.gain(I, dt)
    G = repeated(as_system(name, W, dt), size)
    common_timebase(StateSpace.gain(I, dt), G, ("the plant", name))
    if (G.ny, G.nu) != (size, size):
        raise ModelError(f"{name} is {G.ny} x {G.nu}; pass a system of one channel, or of {size} x {size}")
    return (G.D, StateSpace.gain(I, dt)) if G.n == 0 else (I, G)


def beside(systems: Sequence[StateSpace]) -> StateSpace:
    """Systems that know nothing of each other, as one."""
    A, B, C, D = (np.asarray(sla.block_diag(*(getattr(G, name) for G in systems))) for name in "ABCD")
    n, (p, m) = sum(G.n for G in systems), D.shape
    dt = as_systems(**{f"system {i}": G for i, G in enumerate(systems)})[0].dt
    return StateSpace(A.reshape(n, n), B.reshape(n, m), C.reshape(p, n), D, dt)
