"""A rover of an environment with the camera, the slip estimator and the sand that a scenario would give it."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from controllers.path import Path
from estimators.estimates import Health, SlipAngle
from scenarios.assembly.rover import rover_mount, rover_sensing, trace_schedule
from scenarios.loop.channel import Channel, InLine
from scenarios.loop.stopwatch import Stopwatch
from scenarios.options.rover import RoverScenario
from scenarios.report.canvas import ESTIMATED, SOFT, Picture, blank, write
from scenarios.report.trace_view import draw_trace
from sensors.messages import GreyImage, RoverView
from sensors.sensor import Message
from vehicle.clock import TICK
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
        mount = rover_mount(scenario, rover, terrain, path, seed=seed, signal_noise=signal_noise)
        sensing = rover_sensing(mount)
        if sensing.view is None:
            raise ValueError(f"sensing: the sensor of scenario {scenario.name} is no camera; observation needs one")
        self._rig, self._instruments, self._view = mount.rig, mount.instruments, sensing.view
        estimator = sensing.estimator if estimates else None
        self._estimates = estimates
        self._channel: Channel[RoverTruth, Message, SlipAngle] = Channel(
            sensing.sensor, sensing.schedule, estimator, InLine(), Stopwatch()
        )
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
        """Let the wheels imprint their way to here."""
        self._view.follow(truth)

    def look(self, truth: RoverTruth) -> None:
        """Take an image if one is due, and receive the estimates that are due by now."""
        self._instruments.sample(truth)  # read at every step, seen or not: their errors are a stream
        message = self._channel.sample(truth, truth.tick)
        if isinstance(message, RoverView):
            self._image = truth.tick, message.image
        self._channel.deliver(truth.tick)
        newest = self._channel.newest
        if newest is not None and newest.health is not Health.LOST:
            self._good = newest

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
        if self._estimates:
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
