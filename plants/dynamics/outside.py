"""Plants from outside, flown by `simulation.stepped`: any Python callable, and co-simulation units (FMUs)."""

import difflib
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from plants.errors import EngineError, ScenarioError

RULES = ("rk4", "adaptive", "step")


@dataclass(frozen=True, eq=False)
class CallablePlant:
    """A plant given by a Python callable; built by `callable_plant`. The state is a vector (n,)."""

    f: Callable[[float, np.ndarray, np.ndarray], Any]
    g: Callable[[np.ndarray], Any] | None
    rule: str
    rtol: float

    def advance(self, x: Any, u: Any, t: float, h: float) -> Any:
        """The state (n,), h s on."""
        if self.rule == "step":
            return np.asarray(self.f(t, x, u), float)
        if self.rule == "adaptive":
            solved = solve_ivp(self.f, (t, t + h), x, "DOP853", args=(u,), rtol=self.rtol, atol=self.rtol)
            return solved.y[:, -1] if solved.success else np.full_like(x, np.nan)
        k1 = self._slope(t, x, u)
        k2 = self._slope(t + h / 2, x + h / 2 * k1, u)
        k3 = self._slope(t + h / 2, x + h / 2 * k2, u)
        k4 = self._slope(t + h, x + h * k3, u)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def output(self, x: Any, env: Any) -> Any:
        """(ny,) what g says of the state, or the state."""
        return x if self.g is None else np.asarray(self.g(x), float)

    def _slope(self, t: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        slope = np.asarray(self.f(t, x.copy(), u.copy()), float)
        if slope.shape != x.shape:
            raise ValueError(f"f returned shape {slope.shape}, the state has {x.shape}")
        return slope


def callable_plant(
    f: Callable[[float, np.ndarray, np.ndarray], Any],
    output: Callable[[np.ndarray], Any] | None = None,
    *,
    rule: str = "rk4",
    rtol: float = 1e-9,
) -> CallablePlant:
    """Any Python callable as a plant, ``f(t, x, u)`` of time in s and vectors (n,) and (m,).

    Parameters
    ----------
    f : dx/dt (n,), or the next state (n,) where `rule` is "step"
    output : ``output(x)``, (ny,) what is controlled; the state if left out
    rule : "rk4" is one step of the classical Runge-Kutta method in every of the scenario's `steps` of a sample,
        "adaptive" is DOP853 of SciPy (Hairer, Norsett, Wanner 1993, II.5) to `rtol`, relative and absolute,
        "step" takes f for a discrete system whose step is a sample (divided by `steps`)
    rtol : of "adaptive"

    Raises
    ------
    ScenarioError
        f or output cannot be called, an unknown rule, a tolerance that is not positive.
    """
    for name, value in (("f", f), ("output", output)):
        if not callable(value) and (name == "f" or value is not None):
            raise ScenarioError(f"{name} = {value!r} cannot be called: give a function")
    if rule not in RULES:
        raise ScenarioError(f"rule = {rule!r}: give one of {', '.join(RULES)}")
    if not (np.ndim(rtol) == 0 and np.isfinite(rtol) and rtol > 0):
        raise ScenarioError(f"rtol = {rtol!r}: give a positive finite number")
    return CallablePlant(f, output, rule, float(rtol))


@dataclass(eq=False)
class FmuPlant:
    """A co-simulation unit as a plant; built by `fmu_plant`. The state is the vector of its outputs (ny,).

    What moves stays inside the unit: one flight at a time.
    """

    path: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    start: dict[str, float]
    _about: Any = field(repr=False)
    _unit: Any = field(default=None, repr=False)
    _folder: str = field(default="", repr=False)

    @property
    def initial(self) -> np.ndarray:
        """(ny,) for `Scenario.initial`; the unit's own outputs at t = 0 take its place."""
        return np.zeros(len(self.outputs))

    def begin(self, x: Any) -> np.ndarray:
        """The outputs (ny,) of a fresh instance at t = 0."""
        self.end()
        import fmpy
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        second = self._about.fmiVersion.startswith("2")
        self._folder = tempfile.mkdtemp(prefix="fmu-")
        fmpy.extract(str(self.path), self._folder)
        self._unit = (FMU2Slave if second else FMU3Slave)(
            guid=self._about.guid,
            unzipDirectory=self._folder,
            modelIdentifier=self._about.coSimulation.modelIdentifier,
            instanceName="plant",
        )
        self._unit.instantiate()
        if second:
            self._unit.setupExperiment(startTime=0.0)
        self._set(list(self.start), list(self.start.values()))
        if second:
            self._unit.enterInitializationMode()
        else:
            self._unit.enterInitializationMode(startTime=0.0)
        self._unit.exitInitializationMode()
        return self._get()

    def advance(self, x: Any, u: Any, t: float, h: float) -> np.ndarray:
        """The outputs (ny,) after a communication step of h s."""
        if len(u) != len(self.inputs):
            raise ScenarioError(f"inputs = {', '.join(self.inputs)}: {len(u)} numbers come for {len(self.inputs)}")
        self._set(self.inputs, u)
        self._unit.doStep(currentCommunicationPoint=t, communicationStepSize=h)
        return self._get()

    def output(self, x: Any, env: Any) -> Any:
        """(ny,) the outputs."""
        return x

    def end(self) -> None:
        """Free the instance and what it was unpacked to."""
        unit, self._unit = self._unit, None
        try:
            if unit is not None:
                try:
                    unit.terminate()
                finally:
                    unit.freeInstance()
        finally:
            if self._folder:
                shutil.rmtree(self._folder, ignore_errors=True)
                self._folder = ""

    def _set(self, names: Sequence[str], values: Any) -> None:
        set_ = self._unit.setReal if hasattr(self._unit, "setReal") else self._unit.setFloat64
        if len(names):
            set_(self._references(names), [float(value) for value in values])

    def _get(self) -> np.ndarray:
        get = self._unit.getReal if hasattr(self._unit, "getReal") else self._unit.getFloat64
        return np.array(get(self._references(self.outputs)))

    def _references(self, names: Sequence[str]) -> list[int]:
        known = {v.name: v.valueReference for v in self._about.modelVariables}
        return [known[name] for name in names]


def fmu_plant(
    path: Any, *, inputs: Sequence[str] = (), outputs: Sequence[str] = (), start: Mapping[str, float] | None = None
) -> FmuPlant:
    """A co-simulation FMU of FMI 2.0 or 3.0 as a plant; needs the extra "fmu".

    The unit is stepped by a sample (divided by `steps`), with u held. What its outputs mean after a step is the
    unit's affair: a physical model gives them at the end of the step; a sampled controller as `synth` exports it
    gives C x + D u of the step's beginning, one sample late: export (A, B, C A, C B) to fly (A, B, C, 0) as a plant.

    Parameters
    ----------
    path : the .fmu file
    inputs, outputs : names of scalar real variables, in the order of u and y; by default all, as the file has them
    start : values of parameters and inputs, and of what else has a start value, by name

    Raises
    ------
    ScenarioError
        No FMU, none for co-simulation or for this platform, an unknown variable or one of another causality.
    EngineError
        fmpy is not installed.
    """
    try:
        import fmpy
    except ImportError:
        raise EngineError('fmpy is not installed: pip install "convex-synth[fmu]"') from None
    file = Path(path)
    if not file.is_file():
        raise ScenarioError(f"path = {str(file)!r}: there is no such file")
    try:
        about = fmpy.read_model_description(str(file))
        platforms = fmpy.supported_platforms(str(file))
    except Exception as error:
        why = "it is no zip archive" if not zipfile.is_zipfile(file) else str(error).partition("\n")[0]
        raise ScenarioError(f"path = {str(file)!r} is no FMU that can be read: {why}") from error
    version = str(about.fmiVersion)
    if about.coSimulation is None or version[:1] not in ("2", "3"):
        raise ScenarioError(
            f"path = {str(file)!r} has FMI {version} {'with' if about.coSimulation else 'without'} "
            "co-simulation: export it for co-simulation of FMI 2.0 or 3.0"
        )
    here = (fmpy.platform, fmpy.platform_tuple)
    if not set(here) & set(platforms):
        raise ScenarioError(f"path = {str(file)!r} has binaries for {', '.join(platforms) or 'nothing'}, not {here[0]}")
    variables = {v.name: v for v in about.modelVariables}
    chosen = {}
    for kind, names in (("input", inputs), ("output", outputs)):
        names = (names,) if isinstance(names, str) else tuple(names)
        chosen[kind] = names or tuple(n for n, v in variables.items() if v.causality == kind and _real(v))
        for name in chosen[kind]:
            found = _found(variables, name, f"{kind}s")
            if found.causality != kind:
                raise ScenarioError(f"{kind}s: {name!r} is of causality {found.causality}: give {kind}s")
    if not chosen["output"]:
        raise ScenarioError(f"path = {str(file)!r} has no real output")
    for name, value in (start or {}).items():
        if _found(variables, name, "start").causality in ("output", "independent"):
            raise ScenarioError(f"start: {name!r} is of causality {variables[name].causality}: it cannot be set")
        if not (np.ndim(value) == 0 and np.isfinite(value)):
            raise ScenarioError(f"start: {name} = {value!r}: give a finite number")
    return FmuPlant(file, chosen["input"], chosen["output"], dict(start or {}), about)


def _real(variable: Any) -> bool:
    """Whether this is one real number of double precision."""
    return variable.type in ("Real", "Float64") and not variable.dimensions


def _found(variables: Mapping[str, Any], name: str, where: str) -> Any:
    """The variable of this name, a real scalar."""
    if name not in variables:
        near = difflib.get_close_matches(str(name), variables, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(list(variables)[:12])}"
        raise ScenarioError(f"{where}: the FMU has no variable {name!r}; {hint}")
    if not _real(variables[name]):
        raise ScenarioError(f"{where}: {name!r} is {variables[name].type}: give scalar real variables")
    return variables[name]
