"""A rover of an environment with the camera, the slip estimator and the sand that a scenario would give it."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from controllers.path import Path
from estimators.context import RoverContext, SlipEstimator
from estimators.estimates import Health, SlipAngle
from scenarios.assembly.rover import rover_geometry, sand_world, trace_camera, trace_schedule
from scenarios.catalogue import SLIP_ESTIMATOR, resolve
from scenarios.options.rover import RoverScenario
from scenarios.randomness import stream
from scenarios.report.canvas import ESTIMATED, SOFT, Picture, blank, write
from scenarios.report.trace_view import draw_trace
from sensors.instruments.rover_navigation import RoverInstruments
from sensors.messages import GreyImage, RoverView
from sensors.sand.rig import nominal_rig
from vehicle.clock import TICK, Pipe
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_VIEW: Final = (800, 600)  # of the image for people: as high as the plan beside it [px]


class SensedSlip:
    """What the camera behind a rover's left rear wheel sees of its trace, and what is made of it."""

    def __init__(
        self,
        scenario: RoverScenario,
        rover: Rover,
        terrain: Terrain,
        path: Path,
        *,
        seed: int,
        signal_noise: float,
        estimates: bool,
    ) -> None:
        """Before the first look.

        Args:
            scenario: whose camera, sand, instruments and estimator.
            rover: that leaves the trace.
            terrain: large shape of the ground.
            path: that it is going to take, roughly.
            seed: decides sand and noise.
            signal_noise: errors of compass and encoders, over those of the scenario [-].
            estimates: whether anything is made of the pictures.

        Raises:
            ValueError: one line, for whatever of the scenario does not fit.
        """
        self._rig, self._schedule = nominal_rig(rover), trace_schedule(scenario.rig)
        self._world = sand_world(scenario.world, stream(seed, "sand"), rover, terrain, path)
        self._camera = trace_camera(self._world, self._rig, scenario.rig, stream(seed, "camera noise"))
        scale = signal_noise * scenario.signals.noise
        self._instruments = RoverInstruments(rng=stream(seed, "rover instruments"), scale=scale)
        self._source: SlipEstimator | None = None
        if estimates:
            context = RoverContext(
                rover=rover_geometry(rover), rig=self._rig, rng=stream(seed, "slip estimator"), options={}
            )
            self._source = resolve("slip_estimator", scenario.slip_estimator, SLIP_ESTIMATOR).of(context)
        self._memory: object = self._source.init() if self._source else None
        self._in_flight: Pipe[SlipAngle] = Pipe()
        self._good: SlipAngle | None = None  # the newest estimate with health
        self._image: tuple[int, GreyImage] | None = None  # the newest, with the tick of its capture

    @property
    def slip_angle(self) -> float:
        """The newest estimate with health; 0 before the first [rad]."""
        return 0.0 if self._good is None else self._good.value

    @property
    def image(self) -> GreyImage | None:
        """The newest picture."""
        return None if self._image is None else self._image[1]

    def age(self, tick: int) -> float:
        """How old the newest picture is [s]."""
        return 0.0 if self._image is None else (tick - self._image[0]) * TICK

    def drive(self, truth: RoverTruth) -> None:
        """Lets the wheels go on to here: the sand keeps it."""
        self._world.drive([truth])

    def look(self, truth: RoverTruth) -> None:
        """Takes a picture if one is due, and what has been estimated by now."""
        readings, tick = self._instruments.sample(truth), truth.tick
        if self._schedule.due(tick):
            image = self._camera.sample(truth)
            self._image = tick, image
            if self._source is not None:
                view = RoverView(
                    tick=tick,
                    image=image,
                    heading=readings.heading,
                    wheel_speeds=readings.wheel_speeds,
                    steer=readings.steer,
                )
                self._memory, estimate = self._source.step(self._memory, view)
                if estimate is not None:
                    self._in_flight = self._in_flight.put(tick + self._schedule.latency, estimate)
        self._in_flight, due = self._in_flight.deliver(tick)
        for estimate in due:
            if estimate.health is not Health.LOST:
                self._good = estimate

    def view(self) -> Picture:
        """The newest picture for people, with the estimated direction of the wheel's travel."""
        if self._image is None:
            return blank(*_VIEW)
        shown = np.asarray(cv2.cvtColor(self._image[1], cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        if self._good is not None:
            draw_trace(shown, self._rig, self._good.wheel_slip, self._good.trace_offset, ESTIMATED)
        shown = np.asarray(cv2.resize(shown, _VIEW, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        words = (
            "no estimate yet" if self._good is None else f"estimated slip angle {np.degrees(self._good.value):+.1f} deg"
        )
        if self._source is not None:
            strip = shown[:34]
            strip[:] = 255 - (255 - strip) // 4
            write(shown, words, (12, 8), colour=SOFT)
        return shown


def check_slip_sensing(scenario: RoverScenario, *, estimates: bool, step: int) -> None:
    """Refuses a scenario that an environment with control steps of so many ticks can not take its sensors from.

    Raises:
        ValueError: one line.
    """
    if estimates and scenario.slip_estimator == "truth":
        raise ValueError(f"sensing: scenario {scenario.name} has slip_estimator = truth; use observation = 'truth'")
    schedule = trace_schedule(scenario.rig)
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % step:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of the control step, {step * TICK:g} s")
