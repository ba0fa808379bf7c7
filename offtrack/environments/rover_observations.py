"""Observations of a rover: features, and the camera and slip estimator of a scenario."""

from __future__ import annotations

from operator import attrgetter
from typing import Final

import cv2
import numpy as np

from controllers.path import Path
from estimators.estimates import SlipAngle
from offtrack.environments.core import Feature
from offtrack.environments.sensed import SensedChannel
from offtrack.reports.canvas import ESTIMATED, SOFT, Picture, blank, write
from offtrack.reports.run_video import draw_trace
from scenarios.assembly.adapters import check_schedule, rig_schedule
from scenarios.assembly.rover_run import PERIOD, rover_mount, rover_sensing
from scenarios.loop.channel import InLine
from scenarios.options.rover_scenario import RoverScenario
from sensors.messages import GreyImage, RoverView
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

FEATURES: Final = (
    Feature("cross_track", "m", 2.0),
    Feature("heading_error", "rad", 3.2),
    Feature("curvature", "1/m", 2.0),
    Feature("curvature_ahead", "1/m", 2.0),
    Feature("slip_angle", "rad", 3.2),
    Feature("yaw_rate", "rad/s", 5.0),
    Feature("wheel_speed_left", "set speed", 10.0),
    Feature("wheel_speed_right", "set speed", 10.0),
    Feature("inclination_ahead", "-", 1.0),
    Feature("inclination_left", "-", 1.0),
    Feature("speed", "m/s", 1.0),
)
SLIP: Final = [feature.name for feature in FEATURES].index("slip_angle")
IMAGE_FEATURES: Final = (Feature("age", "s", 60.0), *FEATURES[:SLIP], *FEATURES[SLIP + 1 :])


_VIEW: Final = (800, 600)  # of the image for people: as high as the plan view [px]


class SensedRover:
    """A rover with its instruments and the camera behind its left rear wheel, and the slip estimated from the trace."""

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
        """Open the sensors before the first sample.

        Args:
            scenario: gives camera, sand, instruments and estimator.
            rover: leaves the trace.
            terrain: large shape of the ground.
            path: approximate path of the rover.
            seed: decides sand and noise.
            signal_noise: scale of the errors of compass and encoders, relative to the scenario's [-].
            estimates: True: run the slip estimator on the images.

        Raises:
            ValueError: one line, for whatever of the scenario does not fit.
        """
        mount = rover_mount(scenario, rover, terrain, path, seed=seed, signal_noise=signal_noise)
        sensing = rover_sensing(mount)
        if sensing.view is None:
            raise ValueError(f"sensing: the sensor of scenario {scenario.name} is no camera; observation needs one")
        self._rig, self._instruments, self._trace = mount.rig, mount.instruments, sensing.view
        self._estimates = estimates
        self._channel: SensedChannel[RoverTruth, RoverView, SlipAngle] = SensedChannel(
            sensing.sensor,
            sensing.schedule,
            sensing.estimator if estimates else None,
            InLine(),
            image_type=RoverView,
            health=attrgetter("health"),
        )

    @property
    def slip_angle(self) -> float:
        """The newest estimate with health; 0 before the first [rad]."""
        return 0.0 if self._channel.healthy is None else self._channel.healthy.value

    @property
    def image(self) -> GreyImage | None:
        """The newest image."""
        return None if self._channel.image is None else self._channel.image.image

    def age(self, tick: int) -> float:
        """Age of the newest image; 0 before the first [s]."""
        return self._channel.image_age(tick, without=0.0)

    def drive(self, truth: RoverTruth) -> None:
        """Imprint the trace of the wheels up to this state."""
        self._trace.follow(truth)

    def look(self, truth: RoverTruth) -> None:
        """Capture an image if one is due, and receive the estimates that are due."""
        self._instruments.sample(truth)  # at every step: their errors are a random stream
        self._channel.look(truth)

    def view(self) -> Picture:
        """The newest image for people, with the estimated direction of the wheel's travel."""
        if self.image is None:
            return blank(*_VIEW)
        healthy = self._channel.healthy
        picture = np.asarray(cv2.cvtColor(self.image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        if healthy is not None:
            draw_trace(picture, self._rig, healthy.wheel_slip, healthy.trace_offset, ESTIMATED)
        picture = np.asarray(cv2.resize(picture, _VIEW, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        if self._estimates:
            caption = (
                "no estimate yet" if healthy is None else f"estimated slip angle {np.degrees(healthy.value):+.1f} deg"
            )
            strip = picture[:34]
            strip[:] = 255 - (255 - strip) // 4
            write(picture, caption, (12, 8), colour=SOFT)
        return picture


def check_slip_sensing(scenario: RoverScenario, *, estimates: bool, step: int) -> None:
    """Refuse a scenario whose sensors do not fit an environment with control steps of this many ticks.

    Raises:
        ValueError: one line.
    """
    if estimates and scenario.slip_estimator == "truth":
        raise ValueError(f"sensing: scenario {scenario.name} has slip_estimator = truth; use observation = 'truth'")
    check_schedule(rig_schedule(scenario.rig, PERIOD), step, step_name="the control step, ")
