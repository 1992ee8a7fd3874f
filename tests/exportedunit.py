"""An exported co-simulation unit, instantiated and stepped by fmpy."""

from pathlib import Path


class Unit:
    """An instantiated FMU, with messages collected."""

    def __init__(self, fmpy, path: Path, folder: Path, token: str | None = None):
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        about = fmpy.read_model_description(str(path))
        self.inputs, self.outputs, self.time = (
            [v.valueReference for v in about.modelVariables if v.causality == kind]
            for kind in ("input", "output", "independent")
        )
        self.version = int(about.fmiVersion[0])
        fmpy.extract(str(path), str(folder))
        slave = FMU2Slave if self.version == 2 else FMU3Slave
        self.fmu = slave(
            guid=token or about.guid,
            unzipDirectory=str(folder),
            modelIdentifier=about.coSimulation.modelIdentifier,
            instanceName="controller",
        )
        self.fmu.instantiate()

    def start(self, time: float = 0.0) -> None:
        if self.version == 2:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()

    def set(self, values) -> None:
        (self.fmu.setReal if self.version == 2 else self.fmu.setFloat64)(self.inputs, list(values))

    def get(self) -> list[float]:
        return list((self.fmu.getReal if self.version == 2 else self.fmu.getFloat64)(self.outputs))

    def step(self, time: float, h: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=h)

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()
