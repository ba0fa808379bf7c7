"""Sensors of a rover: the camera over the trace of its wheel, and an exact slip instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.path import Path
from scenarios.catalogue import ROVER_SENSOR, Part, check_made, constructed, resolve
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
    """Instruments with one reading per tick: all users receive the same errors."""

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
        """Remember the motion of the wheels."""
        self._driven.append(truth)

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Ignore messages: they do not change the sand."""

    def sample(self, truth: RoverTruth) -> RoverView:
        """Imprint the wheels' motion since the last image, and take the view."""
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
    """Context of the built-in sensors: they read the whole scenario."""

    scenario: RoverScenario
    path: Path  # reference path; the rover follows it roughly
    rig: TraceRig
    build_world: Callable[[], SandWorld]
    instruments: ReadOnce
    stream: Callable[[str], np.random.Generator]  # random stream of the run, by name


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedRoverSensor:
    """A sensor that is ready to sample."""

    sensor: Sensor[RoverTruth, Message]
    schedule: Schedule
    view: TraceView | None = None  # None: not a camera


class TraceCameraSensor:
    """The camera behind the left rear wheel, with encoders and compass."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Camera of the scenario's rig.

        Raises:
            ValueError: one line, if the ground shows no wheel trace.
        """
        scenario = context.scenario
        if scenario.surface.soil == "none" and scenario.slip_estimator != "truth":
            raise ValueError(
                f"slip_estimator = {scenario.slip_estimator}: hard ground (surface.soil = none) shows no wheel trace"
            )
        world = context.build_world()
        webcam = Webcam(read_noise=scenario.rig.noise, shot_noise=scenario.rig.shot_noise)
        camera = TraceCamera(world, context.rig, webcam, context.stream("camera noise"))
        view = TraceView(world, camera, context.instruments)
        return OpenedRoverSensor(sensor=view, schedule=context.schedule, view=view)


class SlipInstrument:
    """An instrument that measures the slip angle without error, at the rate of the camera."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Exact instrument."""
        return OpenedRoverSensor(sensor=ExactSlip(context.rig.watched), schedule=context.schedule)


def opened_rover_sensor(name: str, context: RoverMountContext) -> OpenedRoverSensor:
    """Open a sensor by its name; a sensor without a schedule of its own samples at the rate of the camera.

    Raises:
        ValueError: one line, if there is no such sensor or the context does not fit.
    """
    part: Part[RoverMountContext, OpenedRoverSensor | Sensor[RoverTruth, Message]] = resolve(
        "sensor", name, ROVER_SENSOR
    )
    sensor = constructed("sensor", name, lambda: part.of(context))
    opened = (
        sensor if isinstance(sensor, OpenedRoverSensor) else OpenedRoverSensor(sensor=sensor, schedule=context.schedule)
    )
    check_made("sensor", name, opened.sensor, ("sample",))
    return opened
