"""Sensors of a rover: the camera that looks at the trace of its wheel, and an exact instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.path import Path
from scenarios.catalogue import ROVER_SENSOR, constructed, resolve
from scenarios.options.rover import RoverScenario
from sensors.context import RoverSensorContext
from sensors.instruments.rover_navigation import ExactSlip, RoverInstruments
from sensors.messages import RoverReadings, RoverView
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import TraceRig
from sensors.sand.world import SandWorld
from sensors.sensor import Message, Sensor
from vehicle.clock import Schedule
from vehicle.rover.truth import RoverTruth


class ReadOnce:
    """Instruments that are read once a tick, whoever asks: their errors are those of one reading."""

    def __init__(self, instruments: RoverInstruments) -> None:
        self._instruments = instruments
        self._last: RoverReadings | None = None

    def sample(self, truth: RoverTruth) -> RoverReadings:
        """Readings at this tick."""
        if self._last is None or self._last.tick != truth.tick:
            self._last = self._instruments.sample(truth)
        return self._last


class TraceView:
    """The camera over the sand with encoders and compass; the sand keeps the imprints of the wheels."""

    def __init__(self, world: SandWorld, camera: TraceCamera, instruments: ReadOnce) -> None:
        self.camera = camera
        self._world, self._instruments = world, instruments
        self._driven: list[RoverTruth] = []  # since the last image

    def follow(self, truth: RoverTruth) -> None:
        """Remember where the wheels have been."""
        self._driven.append(truth)

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Messages leave the sand as it is."""

    def sample(self, truth: RoverTruth) -> RoverView:
        """The view of this moment, after the wheels have imprinted their way so far."""
        self._world.drive(self._driven)
        self._driven = []
        readings = self._instruments.sample(truth)
        return RoverView(
            tick=truth.tick,
            image=self.camera.sample(truth),
            heading=readings.heading,
            wheel_speeds=readings.wheel_speeds,
            steer=readings.steer,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverMountContext(RoverSensorContext):
    """Context of the sensors that come with offtrack: they read the whole scenario."""

    scenario: RoverScenario
    path: Path  # that the rover is going to take, roughly
    rig: TraceRig
    build_world: Callable[[], SandWorld]
    instruments: ReadOnce
    stream: Callable[[str], np.random.Generator]  # random stream of the run, by name


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedRoverSensor:
    """A sensor that is ready to sample."""

    sensor: Sensor[RoverTruth, Message]
    schedule: Schedule
    view: TraceView | None = None  # behind it, if it is the camera


class RoverSensor(Protocol):
    """Class of sensors on rovers, as the catalogue holds them."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor | Sensor[RoverTruth, Message]:
        """Sensor on the rover; a bare sensor samples at the rate of the scenario's camera.

        Raises:
            ValueError: one line, if the context does not fit.
        """


class TraceCameraSensor:
    """The camera behind the left rear wheel, with encoders and compass."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Camera of the scenario's rig.

        Raises:
            ValueError: one line, if the ground takes no trace.
        """
        scenario = context.scenario
        if scenario.surface.soil == "none" and scenario.slip_estimator != "truth":
            raise ValueError(
                f"slip_estimator = {scenario.slip_estimator}: hard ground (surface.soil = none) takes no trace"
            )
        world = context.build_world()
        webcam = Webcam(read_noise=scenario.rig.noise, shot_noise=scenario.rig.shot_noise)
        camera = TraceCamera(world, context.rig, webcam, context.stream("camera noise"))
        view = TraceView(world, camera, context.instruments)
        return OpenedRoverSensor(sensor=view, schedule=context.schedule, view=view)


class SlipInstrument:
    """An instrument that reads the slip angle without any error, as often as the camera looks."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Exact instrument."""
        return OpenedRoverSensor(sensor=ExactSlip(context.rig.watched), schedule=context.schedule)


def opened_rover_sensor(name: str, context: RoverMountContext) -> OpenedRoverSensor:
    """Open a sensor of the catalogue, or one's own, by its name.

    Raises:
        ValueError: one line, if there is no such sensor or it does not fit.
    """
    part: type[RoverSensor] = resolve("sensor", name, ROVER_SENSOR)
    sensor = constructed("sensor", name, part, context)
    return (
        sensor if isinstance(sensor, OpenedRoverSensor) else OpenedRoverSensor(sensor=sensor, schedule=context.schedule)
    )
