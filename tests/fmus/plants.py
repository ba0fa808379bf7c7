"""Exported plants in FMPy, stepped through a weave, and the plants of this process beside them."""

import ctypes
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave, fmi3IntermediateUpdateCallback

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import command_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, rotation_zyx
from vehicle.surface import Surface

START: Final = {"start_x": 1.0, "start_y": 2.0, "start_psi": 0.3, "start_speed": 8.0}
STEP: Final = 0.01  # [s]


class Slave:
    """An initialised instance of an FMU of either version."""

    def __init__(self, fmu: Path, folder: Path, values: Mapping[str, float] | None = None,
                 texts: Mapping[str, str] | None = None) -> None:  # fmt: skip
        self.description = fmpy.read_model_description(str(fmu))
        self.reference = {one.name: one.valueReference for one in self.description.modelVariables}
        self.messages: list[str] = []
        if not folder.exists():
            fmpy.extract(str(fmu), str(folder))
        is_2 = self.description.fmiVersion == "2.0"
        token = self.description.guid if is_2 else self.description.instantiationToken
        self.fmu: Any = (FMU2Slave if is_2 else FMU3Slave)(
            guid=token,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self._set, self._get = (
            (self.fmu.setReal, self.fmu.getReal) if is_2 else (self.fmu.setFloat64, self.fmu.getFloat64)
        )
        self._is_2 = is_2
        self._instantiate(is_2)
        self.begin(values, texts)

    def begin(self, values: Mapping[str, float] | None = None, texts: Mapping[str, str] | None = None) -> None:
        if self._is_2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(values or {})
        for name, text in (texts or {}).items():
            self.fmu.setString([self.reference[name]], [text])
        self.time = 0.0
        self.fmu.exitInitializationMode()

    def _instantiate(self, is_2: bool) -> None:
        if not is_2:
            from fmpy.fmi3 import fmi3LogMessageCallback

            self._log = fmi3LogMessageCallback(
                lambda _env, _status, _kind, message: self.messages.append((message or b"").decode())
            )
            self.fmu.instantiate(logMessage=self._log)
            return
        from fmpy.fmi2 import (
            fmi2CallbackAllocateMemoryTYPE,
            fmi2CallbackFreeMemoryTYPE,
            fmi2CallbackFunctions,
            fmi2CallbackLoggerTYPE,
        )

        # the message is an argument of a "%s", which this callback of fixed arguments takes as well
        logger_type = ctypes.CFUNCTYPE(
            None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p
        )
        self._log = logger_type(lambda _e, _n, _s, _c, _format, message: self.messages.append(message.decode()))
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = ctypes.cast(self._log, fmi2CallbackLoggerTYPE)
        self._callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(0)
        self._callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(0)
        self.fmu.instantiate(callbacks=self._callbacks)

    def set(self, values: Mapping[str, float]) -> None:
        self._set([self.reference[name] for name in values], list(values.values()))

    def get(self, names: list[str]) -> list[float]:
        values: list[float] = self._get([self.reference[name] for name in names])
        return values

    def step(self, length: float = STEP) -> None:
        """One communication step [s]."""
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=length)
        self.time = round(self.time + length, 9)

    @property
    def outputs(self) -> list[str]:
        return [one.name for one in self.description.modelVariables if one.causality == "output"]

    def again(self, folder: Path, texts: Mapping[str, str] | None = None) -> None:
        """Make, begin, step and free a further instance of an FMU of version 3 that is unpacked into a folder."""
        token, resources = self.description.instantiationToken.encode(), f"{folder / 'resources'}/".encode()
        rest = (False, False, False, False, None, 0, None, self._log, fmi3IntermediateUpdateCallback(0))
        kept = self.fmu.component
        self.fmu.component = self.fmu.fmi3InstantiateCoSimulation(b"x", token, resources, *rest)
        assert self.fmu.component
        self.begin({}, texts)
        self.step()
        self.fmu.fmi3FreeInstance(self.fmu.component)
        self.fmu.component = kept

    def close(self) -> None:
        self.fmu.freeInstance()


class Drive(NamedTuple):
    steer: FloatArray
    acceleration: FloatArray
    trailer: FloatArray


def weave(seconds: float) -> Drive:
    t = np.arange(round(seconds / STEP)) * STEP
    return Drive(0.1 * np.sin(0.6 * t), 0.5 * np.sin(0.4 * t), 0.05 * np.sin(0.8 * t))


def driven_here(vehicle: Vehicle, drive: Drive) -> list[Truth]:
    """Ground truth of the plant of this process before the first and after every step."""
    plant = Plant(vehicle, Surface(friction=0.8))
    state = plant.initial_state(Pose2(1.0, 2.0, 0.3), 8.0)
    truths = [plant.observe(state, 0)]
    n = command_sizes(vehicle).trailer_steer
    for steer, acceleration, trailer in zip(*drive, strict=True):
        state = plant.step(state, VehicleCommand(float(steer), float(acceleration), (float(trailer),) * n), 10)
        truths.append(plant.observe(state, 0))
    return truths


def driven_there(slave: Slave, vehicle: Vehicle, drive: Drive) -> dict[str, FloatArray]:
    """Outputs of an FMU by name, before the first and after every step."""
    names, n = slave.outputs, command_sizes(vehicle).trailer_steer
    rows = [slave.get(names)]
    for steer, acceleration, trailer in zip(*drive, strict=True):
        demands = {f"steer_trailer_{k}": trailer for k in range(1, n + 1)}
        slave.set({"steer": steer, "acceleration": acceleration, **demands})
        slave.step()
        rows.append(slave.get(names))
    return dict(zip(names, np.array(rows).T, strict=True))


def deviations(truths: list[Truth], outputs: Mapping[str, FloatArray]) -> dict[str, float]:
    """Largest difference of every kind of quantity, from all fields of ``Truth``."""

    def numbered(name: str, n: int) -> FloatArray:
        return np.column_stack([outputs[f"{name}_{k}"] for k in range(1, n + 1)])

    triples = {"poses": ("x", "y", "psi"), "velocities": ("v_x", "v_y", "yaw_rate")}
    there = {
        name: np.array([getattr(truth, field)[:, k] for truth in truths])
        for field, names in triples.items()
        for k, name in enumerate(names)
    }
    for k, axis in enumerate("xyz"):
        there[f"body_{axis}"] = np.array([truth.bodies[:, k, 3] for truth in truths])
    single = {"steer_angle": "steer", "wheel_load": "wheel_loads", "wheel_slip_angle": "wheel_slip_angles"}
    single |= {name: name for name in ("friction_used", "load_transfer")}
    there |= {name: np.array([getattr(truth, field) for truth in truths]) for name, field in single.items()}
    found = {name: float(np.abs(numbered(name, one.shape[1]) - one).max()) for name, one in there.items()}
    angles = [numbered(f"body_{name}", len(truths[0].poses)) for name in ("yaw", "pitch", "roll")]
    found["attitude"] = max(
        float(np.max(np.abs(rotation_zyx(*(float(angle[row, unit]) for angle in angles)) - X[:3, :3])))
        for row, truth in enumerate(truths)
        for unit, X in enumerate(truth.bodies)
    )
    return found


def c_compiler() -> str | None:
    return shutil.which("cc") or shutil.which("gcc")
