"""Laws for magnetorquers: damping of a tumble, and momentum taken out of the wheels.

A dipole moment m in the field B turns the body by m x B, across the field only, so of a wanted torque T the part across
it is what m = B x T / |B|^2 gives. Functions of NumPy arrays give NumPy arrays, of JAX's JAX's.

    B-dot           T = -k (part of w across B): Stickler and Alfriend 1976, Journal of Spacecraft 13, 282; gain of
                    Avanzini and Giulietti 2012, Journal of Guidance 35, 1326
    cross product   T = k dh: Camillo and Markley 1980, Journal of Guidance and Control 3, 563
    LQR             m = R^-1 B x (P dh), P of the Riccati equation of the field's average over an orbit: Psiaki 2001,
                    Journal of Guidance 24, 386

dh is the momentum that is wanted less the one that is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from scipy.linalg import LinAlgError, expm, solve_continuous_are

from plants.checks import Numbers, each, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.simulation.loop import Environment
from plants.simulation.programs import Program


def field_rate(rate: Any, field: Any) -> Any:
    """How fast the field changes for a body that turns, seen from it: dB/dt = -w x B, (3,) T/s.

    Parameters
    ----------
    rate : (3,) rad/s, inertial, body axes; the turn of the field along the orbit is left out
    field : (3,) T, body axes
    """
    return _library(rate, field).cross(field, rate)


def bdot(field_rate: Any, field: Any, *, gain: Any, limit: Any = np.inf) -> Any:
    """Dipole moment against the change of the field, m = -k dB/dt / |B|^2: (3,) A m^2, body axes.

    Parameters
    ----------
    field_rate : (3,) T/s, seen from the body: `field_rate` of a gyro, or the difference of two measurements over time
    field : (3,) T, body axes
    gain : () N m s, torque across the field per rate: see `bdot_gain`
    limit : () or (3,) A m^2; beyond it the dipole moment is made smaller as a whole
    """
    library = _library(field_rate, field)
    return _within(library, -gain * library.asarray(field_rate) / _square(library, field), limit)


def bdot_gain(orbit_rate: float, inclination: float, least_inertia: float) -> float:
    """Gain of `bdot`, () N m s: 2 n (1 + sin i) J.

    Parameters
    ----------
    orbit_rate : () rad/s
    inclination : () rad, against the geomagnetic equator
    least_inertia : () kg m^2, least principal moment

    Raises
    ------
    ScenarioError
        NaN, a rate or an inertia that is not positive.
    """
    n, J = float(positive("orbit_rate", orbit_rate)), float(positive("least_inertia", least_inertia))
    return 2 * n * (1 + abs(np.sin(float(real("inclination", inclination))))) * J


def cross_product(momentum_error: Any, field: Any, *, gain: Any, limit: Any = np.inf) -> Any:
    """Dipole moment whose torque changes the momentum towards the wanted, m = k B x dh / |B|^2: (3,) A m^2, body axes.

    Parameters
    ----------
    momentum_error : (3,) N m s, body axes, wanted less held
    field : (3,) T, body axes
    gain : () 1/s; in a field at rest what is across it decays as exp(-k t)
    limit : () or (3,) A m^2; beyond it the dipole moment is made smaller as a whole
    """
    library = _library(momentum_error, field)
    return _within(library, gain * library.cross(field, momentum_error) / _square(library, field), limit)


@partial(blocks.node, data_fields=["gain", "limit", "wanted"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class CrossProductDumping:
    """Momentum dumping by `cross_product`. Build it with `CrossProductDumping.create`."""

    gain: Numbers  # () 1/s
    limit: Numbers  # (3,) A m^2
    wanted: Numbers  # (3,) N m s, body axes

    @classmethod
    def create(
        cls, gain: ArrayLike, *, limit: ArrayLike = np.inf, wanted: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)
    ) -> "CrossProductDumping":
        """Dumping at the rate `gain` () 1/s, with dipole moments within `limit` () or (3,) A m^2.

        Raises
        ------
        ScenarioError
            A gain or limit that is not positive; a momentum `wanted` that is not (3,) N m s.
        """
        return cls(
            gain=positive("gain", gain),
            limit=each("limit", limit, 3, positive, infinite=True),
            wanted=real("wanted", wanted, (3,)),
        )

    def dipole(self, momentum: Any, field: Any) -> Any:
        """Dipole moment (3,) A m^2 for the momentum (3,) N m s of the wheels in a field (3,) T, all in body axes."""
        return cross_product(self.wanted - momentum, field, gain=self.gain, limit=self.limit)


@partial(blocks.node, data_fields=["gain", "limit", "wanted", "radius"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class LqrDumping:
    """Momentum dumping by the LQR of the averaged field. Build it with `LqrDumping.create`."""

    gain: Numbers  # (3, 3) A m^2 / (T N m s): R^-1 P
    limit: Numbers  # (3,) A m^2
    wanted: Numbers  # (3,) N m s, body axes
    radius: Numbers  # () of the eigenvalues of an orbit's transition: what is left after one, in the long run

    @classmethod
    def create(
        cls,
        field: ArrayLike,
        period: float,
        *,
        dipole: float,
        momentum: float,
        rate: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
        limit: ArrayLike = np.inf,
        wanted: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    ) -> "LqrDumping":
        """The law for the field of an orbit, for a body that rests in a frame that may turn.

        Minimises the integral of |dh / momentum|^2 + |m / dipole|^2 for the average of the field's effect; that the law
        works with the field as it is, is tested by integrating over the orbit.

        Parameters
        ----------
        field : (n, 3) T, at equal times over the orbit, in the axes in which the body rests, such as frame O
        period : () s, of the orbit
        dipole : () A m^2, dipole moment that costs as much as
        momentum : () N m s, this error of the momentum
        rate : (3,) rad/s, inertial rate of the axes, in these axes
        limit : () or (3,) A m^2; beyond it the dipole moment is made smaller as a whole
        wanted : (3,) N m s, body axes

        Raises
        ------
        ScenarioError
            Unusable numbers; a field that keeps its direction, so that some momentum stays for ever; a law so strong
            that it does not work with the field as it is.
        """
        B, w = real("field", field, (None, 3)), real("rate", rate, (3,))
        ratio = positive("dipole", dipole) / positive("momentum", momentum)
        step = float(positive("period", period)) / max(len(B), 1)
        if len(B) < 8:
            raise ScenarioError(f"field has {len(B)} rows: give at least 8 points of the orbit")
        push = -_cross_matrices(B)  # torque m x B = push @ m
        turn = -_cross_matrices(w[None])[0]  # of a momentum at rest, in the turning axes
        size = positive("field", np.sqrt(np.mean(np.sum(B**2, axis=1))))
        effect = np.mean(push @ np.swapaxes(push, 1, 2), axis=0) / size**2
        A = turn / (size * ratio)  # momentum in units of `momentum`, time in those of 1 / (size ratio)
        unit_turn = turn / max(np.linalg.norm(w), 1e-300)
        reached = np.hstack([effect, unit_turn @ effect, unit_turn @ unit_turn @ effect])
        if not np.linalg.svd(reached, compute_uv=False)[-1] > 1e-6:
            raise ScenarioError("field keeps its direction along the orbit: momentum along it cannot be dumped")
        try:
            values, vectors = np.linalg.eigh(effect)
            P = solve_continuous_are(A, vectors * np.sqrt(np.maximum(values, 0.0)), np.eye(3), np.eye(3))
        except LinAlgError as error:
            raise ScenarioError(
                f"field, dipole and momentum give no regulator ({error}): change their ratio"
            ) from error
        gain = ratio * P / size
        left = np.eye(3)
        for matrix in push @ np.swapaxes(push, 1, 2) @ gain:
            left = expm((turn - matrix) * step) @ left
        radius = np.abs(np.linalg.eigvals(left)).max()
        if not radius < 1:
            raise ScenarioError(
                f"with dipole / momentum = {ratio:g} A/(N s) the momentum grows by {radius:g} in an orbit: lower it"
            )
        return cls(
            gain=gain,
            limit=each("limit", limit, 3, positive, infinite=True),
            wanted=real("wanted", wanted, (3,)),
            radius=radius,
        )

    @classmethod
    def along(
        cls,
        environment: Environment,
        period: float,
        *,
        dipole: float,
        momentum: float,
        points: int = 360,
        limit: ArrayLike = np.inf,
        wanted: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    ) -> "LqrDumping":
        """The law for a body at rest in frame O of an environment, from the field of its first orbit.

        Parameters
        ----------
        environment : with a magnetic field, over `period` at least
        period : () s, of the orbit
        dipole, momentum, limit, wanted : as in `create`
        points : of the orbit

        Raises
        ------
        ScenarioError
            What `create` refuses; an environment without a field, or shorter than the orbit.
        """
        blocks.register(environment)
        with jax.enable_x64(True):
            times = np.arange(points) * (float(positive("period", period)) / points)
            field, rate = (np.asarray(part) for part in _orbit(environment, times))
        if not np.isfinite(field).all():
            raise ScenarioError(f"environment gives no magnetic field over the {period:g} s of an orbit")
        return cls.create(
            field, period, dipole=dipole, momentum=momentum, rate=rate.mean(axis=0), limit=limit, wanted=wanted
        )

    def dipole(self, momentum: Any, field: Any) -> Any:
        """Dipole moment (3,) A m^2 for the momentum (3,) N m s of the wheels in a field (3,) T, all in body axes."""
        library = _library(momentum, field)
        return _within(library, library.cross(field, self.gain @ (self.wanted - momentum)), self.limit)


@Program
def _orbit(environment: Any, times: Any) -> tuple[Any, Any]:
    """Field (n, 3) T in frame O, and the rate (n, 3) rad/s of that frame."""
    env = jax.vmap(environment.at)(times)
    return attitude.rotate(env.q_ON, env.B), env.w_ON


def _library(*arrays: Any) -> Any:
    """NumPy, if all arrays are its own, else JAX's."""
    return np if all(isinstance(array, np.ndarray | list | tuple) for array in arrays) else jnp


def _square(library: Any, field: Any) -> Any:
    """|B|^2, or 1 where there is no field, which then turns nothing."""
    square = library.sum(library.asarray(field) ** 2)
    return library.where(square > 0, square, 1.0)


def _within(library: Any, dipole: Any, limit: Any) -> Any:
    """The dipole moment, made smaller as a whole where an axis is beyond its limit."""
    return dipole / library.maximum(1.0, library.max(library.abs(dipole) / limit))


def _cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """[v x] of (n, 3) vectors, (n, 3, 3)."""
    return np.cross(vectors[:, None, :], np.eye(3)[None], axis=-1).swapaxes(1, 2)
