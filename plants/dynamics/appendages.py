"""Flexible appendages in hybrid coordinates: panels, booms and tanks by the modes they have on a hub that is held.

Mode i of an appendage that is clamped to the hub has the frequency W_i, the damping z_i and the coupling d_i, the
angular momentum about the centre of mass per unit of modal rate. With H = J w + h + d eta', h of wheels and gyroscopes,

    J w' + d eta'' + w x H = T,      eta'' + 2 z W eta' + W^2 eta + d' w' = 0

Likins (1970), JPL TR 32-1329. J (3, 3) is that of the undeformed body. Left out are products of w and eta (change of
inertia, centrifugal stiffness) and the motion of the hub's centre of mass, which is none for panels in pairs. Without
damping and torque the model keeps the energy (w' J w + 2 w' d eta' + eta'^2 + eta W^2 eta) / 2 and the inertial H.

Eliminating eta'' leaves the hub with the inertia J - d d', which must be positive definite: the modes cannot carry more
than there is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from numpy.typing import ArrayLike

from plants.checks import Numbers, each, positive, real, unit
from plants.dynamics.inertia import inertia_matrix
from plants.errors import ScenarioError
from plants.simulation import blocks


class DescriptorModel(NamedTuple):
    """Continuous model E x' = A x + B u, y = C x + D u; its entries may be expressions of uncertain parameters."""

    E: np.ndarray  # (n, n)
    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, a)
    C: np.ndarray  # (2 a, n)
    D: np.ndarray  # (2 a, a)


@partial(blocks.node, data_fields=["frequencies", "damping", "couplings"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Appendage:
    """The m modes of a flexible appendage, or of several. Build it with `create`, `hinged`, `pendulum`, `joined`."""

    frequencies: Numbers  # (m,) rad/s, of the appendage on a hub that is held
    damping: Numbers  # (m,) of the critical one
    couplings: Numbers  # (3, m) sqrt(kg) m, body axes

    @classmethod
    def create(cls, frequencies: ArrayLike, *, couplings: ArrayLike, damping: ArrayLike = 0.0) -> "Appendage":
        """An appendage from its modes, as a finite-element model lists them.

        Parameters
        ----------
        frequencies : (m,) rad/s, with the hub held
        couplings : (3, m) sqrt(kg) m, int r x phi_i dm of the mass-normalised mode shapes phi_i, body axes
        damping : () or (m,) of the critical one

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, no mode, a frequency that is not positive, a damping below zero.
        """
        W = positive("frequencies", frequencies, (None,))
        m = W.shape[0]
        if m == 0:
            raise ScenarioError("frequencies is empty: give at least one, or leave the appendage out")
        return cls(
            frequencies=W,
            damping=each("damping", damping, m, real, low=0),
            couplings=real("couplings", couplings, (3, m)),
        )

    @classmethod
    def hinged(
        cls,
        axis: ArrayLike,
        *,
        position: ArrayLike,
        mass: ArrayLike,
        centre: ArrayLike,
        inertia: ArrayLike,
        stiffness: ArrayLike,
        damping: ArrayLike = 0.0,
    ) -> "Appendage":
        """A rigid panel on a hinge with a spring: one mode.

        Parameters
        ----------
        axis : (3,) unit vector of the hinge
        position : (3,) m, of the hinge from the centre of mass of the whole
        mass : () kg
        centre : (3,) m, of the panel's mass from the hinge, at rest
        inertia : (3, 3) kg m^2, or (3,) its diagonal, about the panel's own centre of mass
        stiffness : () N m/rad
        damping : () of the critical one

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, a mass or stiffness that is not positive, no inertia about the hinge.
        """
        a, r, c = unit("axis", axis, (3,)), real("position", position, (3,)), real("centre", centre, (3,))
        m, k = positive("mass", mass), positive("stiffness", stiffness)
        swing = _cross(a, c)  # of the panel's centre, per unit of angle
        momentum = inertia_matrix("inertia", inertia) @ a + m * _cross(c, swing)  # about the hinge
        about = positive("inertia about the hinge", a @ momentum)
        coupling = (momentum + m * _cross(r, swing)) / about**0.5
        return cls.create(((k / about) ** 0.5)[None], couplings=coupling[:, None], damping=damping)

    @classmethod
    def pendulum(
        cls, mass: ArrayLike, *, length: ArrayLike, hinge: ArrayLike, acceleration: ArrayLike, damping: ArrayLike = 0.0
    ) -> "Appendage":
        """The sloshing mass of a tank under thrust: it swings in two directions, at sqrt(acceleration / length).

        Parameters
        ----------
        mass : () kg, of the liquid that swings
        length : () m, of the pendulum
        hinge : (3,) m, from the centre of mass
        acceleration : (3,) m/s^2 of the spacecraft, body axes; the mass hangs against it
        damping : () of the critical one

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, a mass or length that is not positive, no acceleration: nothing drives the mass back.
        """
        m, l = positive("mass", mass), positive("length", length)
        r, a = real("hinge", hinge, (3,)), real("acceleration", acceleration, (3,))
        library: Any = jnp if isinstance(a, Tracer) else np
        size = positive("acceleration", (a @ a) ** 0.5)
        up = a / size
        rest = r - l * up
        far = library.eye(3)[library.argmin(abs(up))]  # the body axis farthest from it
        first = _cross(up, far) / ((1 - (up @ far) ** 2) ** 0.5)
        swings = library.stack([first, _cross(up, first)])
        couplings = m**0.5 * _cross(library.stack([rest, rest]), swings).T
        return cls.create(library.stack([(size / l) ** 0.5] * 2), couplings=couplings, damping=damping)

    @classmethod
    def joined(cls, appendages: Sequence["Appendage"]) -> "Appendage":
        """All modes of several appendages as those of one.

        Raises
        ------
        ScenarioError
            No sequence of appendages, or an empty one.
        """
        if not isinstance(appendages, Sequence) or not all(isinstance(part, Appendage) for part in appendages):
            raise ScenarioError(f"appendages is {appendages!r}: give a list of Appendage.create(...) and the like")
        if not appendages:
            raise ScenarioError("appendages is empty: there is nothing to join")
        library: Any = jnp if any(isinstance(part.frequencies, Tracer) for part in appendages) else np
        parts = ("frequencies", "damping", "couplings")
        return cls(**{name: library.concatenate([getattr(a, name) for a in appendages], axis=-1) for name in parts})

    def hub(self, inertia: Any) -> Any:
        """What inertia (3, 3) kg m^2 of the whole leaves for the hub: J - d d'.

        Raises
        ------
        ScenarioError
            It is not positive definite.
        """
        d: Any = self.couplings
        rest = inertia - d @ d.T
        if not isinstance(rest, Tracer) and np.linalg.eigvalsh(rest)[0] <= 0:
            raise ScenarioError(
                f"inertia without what the appendages carry must be positive definite, got {np.asarray(rest).tolist()} "
                "kg m^2: inertia is that of the whole spacecraft, couplings are in sqrt(kg) m, from one data sheet"
            )
        return rest

    def free(self, inertia: ArrayLike) -> np.ndarray:
        """Frequencies (m,) rad/s, ascending, on a free body of inertia (3, 3) or (3,) kg m^2 at rest, without damping.

        W^2 eta = w^2 (1 - d' J^-1 d) eta: of a single mode W / sqrt(1 - d' J^-1 d), above the one with the hub held.
        """
        J, W, d = inertia_matrix("inertia", inertia), np.asarray(self.frequencies), np.asarray(self.couplings)
        self.hub(J)
        flexibility = (np.eye(len(W)) - d.T @ np.linalg.solve(J, d)) / np.outer(W, W)
        return np.sort(1 / np.sqrt(np.linalg.eigvalsh(flexibility)))

    def momentum(self, rates: ArrayLike) -> Array:
        """Angular momentum (3,) N m s of the deformation, body axes, at modal rates (m,) sqrt(kg) m/s."""
        return jnp.asarray(self.couplings) @ jnp.asarray(rates)

    def restoring(self, modes: ArrayLike, rates: ArrayLike) -> Array:
        """2 z W eta' + W^2 eta, (m,) sqrt(kg) m/s^2, at modal coordinates and rates (m,)."""
        W = jnp.asarray(self.frequencies)
        return 2 * jnp.asarray(self.damping) * W * jnp.asarray(rates) + W**2 * jnp.asarray(modes)


def flexible_model(
    inertia: Any, frequencies: Any, *, couplings: Any, damping: Any, momentum: Any = None
) -> DescriptorModel:
    """Small motions about rest of a body with flexible modes, about `a` of its axes, with the inertia on the left.

    Every argument may hold expressions of uncertain parameters, such as `synth.ureal`: the entries stay polynomials in
    them, and `synth.UncertainSystem(*flexible_model(...))` is the uncertain plant. State [angles (a,); eta (m,);
    rates (a,); eta' (m,)], input the torque on the body (a,) N m, output [angles rad; rates rad/s].

    Parameters
    ----------
    inertia : (a, a) or (a,) kg m^2, or for a single axis a number; without the wheels about their spin axes
    frequencies : (m,) rad/s, with the hub held
    couplings : (a, m) sqrt(kg) m, or for a single axis (m,)
    damping : () or (m,) of the critical one
    momentum : (3,) N m s held by wheels, for a = 3

    Raises
    ------
    ScenarioError
        Shapes that do not fit together, NaN.
    """
    given = {"inertia": inertia, "frequencies": frequencies, "couplings": couplings, "damping": damping}
    J, W, d, z = (_entries(name, part) for name, part in given.items())
    J = np.atleast_1d(J)
    J = np.diag(J) if J.ndim == 1 else J
    d = d[None] if d.ndim == 1 else d
    a, m = len(J), W.size
    z = np.full(m, z[()]) if z.ndim == 0 else z
    shapes = {"inertia": (J, (a, a)), "frequencies": (W, (m,)), "couplings": (d, (a, m)), "damping": (z, (m,))}
    for name, (part, shape) in shapes.items():
        if part.shape != shape:
            raise ScenarioError(f"{name} has shape {part.shape}: give {shape} for {a} axes and {m} modes")
    n = a + m
    E, A = np.eye(2 * n).astype(object), np.zeros((2 * n, 2 * n), object)
    A[:n, n:] = np.eye(n)
    E[n : n + a, n : n + a], E[n : n + a, n + a :], E[n + a :, n : n + a] = J, d, d.T
    for k in range(m):
        A[n + a + k, a + k], A[n + a + k, n + a + k] = -(W[k] * W[k]), -2 * z[k] * W[k]
    if momentum is not None:
        if a != 3:
            raise ScenarioError(f"momentum couples three axes, and inertia has {a}: leave it out")
        A[n : n + a, n : n + a] = np.cross(np.eye(3), real("momentum", momentum, (3,)))
    B, C = np.zeros((2 * n, a)), np.zeros((2 * a, 2 * n))
    B[n : n + a] = np.eye(a)
    C[:a, :a] = C[a:, n : n + a] = np.eye(a)
    E, A = (M.astype(float) if all(map(np.isscalar, M.flat)) else M for M in (E, A))
    return DescriptorModel(E, A, B, C, np.zeros((2 * a, a)))


def _entries(name: str, value: Any) -> np.ndarray:
    """An array of numbers and expressions; the numbers are finite."""
    array = np.asarray(value, object)
    real(name, [entry for entry in array.flat if np.isscalar(entry)], (None,))
    return array


def _cross(a: Any, b: Any) -> Any:
    """A x b, concrete or traced."""
    return (jnp if isinstance(a, Tracer) or isinstance(b, Tracer) else np).cross(a, b)
