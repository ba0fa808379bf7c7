"""Options and sensors of ``RoverSteering``: reward, ranges of episodes, features, camera and slip estimator."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, NamedTuple

import cv2
import numpy as np

from controllers.path import Path
from estimators.estimates import SlipAngle
from offtrack.environments.core import Feature
from offtrack.environments.observations import ObservationKind
from offtrack.environments.pictures import SensedChannel
from offtrack.environments.rewards import EpisodeOptions, Range, Ranges, drawn_from
from offtrack.reports.canvas import ESTIMATED, SOFT, Picture, blank, curve, write
from scenarios.assembly.adapters import check_schedule, rig_schedule
from scenarios.assembly.rover_run import PERIOD, rover_mount, rover_sensing
from scenarios.loop.channel import InLine
from scenarios.options.scenario import RoverScenario, load_any_scenario, of_kind
from scenarios.results.rover_result import trace_line
from sensors.messages import GreyImage, RoverView
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray
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
        sensing = rover_sensing(scenario, mount)
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
            curve(picture, trace_line(self._rig, healthy.wheel_slip, healthy.trace_offset), ESTIMATED, 2)
        picture = np.asarray(cv2.resize(picture, _VIEW, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        if self._estimates:
            caption = (
                "no estimate yet" if healthy is None else f"estimated slip angle {np.degrees(healthy.value):+.1f} deg"
            )
            strip = picture[:34]
            strip[:] = 255 - (255 - strip) // 4
            write(picture, caption, (12, 8), colour=SOFT)
        return picture


class RoverMoment(NamedTuple):
    """Ground truth of n rovers after a step, independent of the observation."""

    cross_track: FloatArray  # (n,) of R's origin from the path, + left [m]
    heading_error: FloatArray  # (n,) from the path's direction, + left [rad]
    slip_angle: FloatArray  # (n,) direction of travel relative to the heading, + left [rad]
    yaw_rate: FloatArray  # (n,) [rad/s]
    progress: FloatArray  # (n,) along the path, mean over the step [m/s]
    speed: FloatArray  # (n,) set speed of the wheels [m/s]
    demand_left: FloatArray  # (n,) wheel speed demanded of the left side, over its largest [-]
    demand_right: FloatArray  # (n,) of the right side [-]
    sinkage: FloatArray  # (n,) of the wheel that has sunk in most [m]


RoverReward = Callable[[RoverMoment], FloatArray]  # (n,)


def cross_track_error(moment: RoverMoment) -> FloatArray:
    """Minus the squared distance from the path [dm2]."""
    return np.asarray(-((moment.cross_track / 0.1) ** 2))


def off_path(moment: RoverMoment) -> FloatArray:
    """Minus the distance from the path [m]: the cost is linear."""
    return -np.abs(moment.cross_track)


def slowness(moment: RoverMoment) -> FloatArray:
    """Minus the squared lack of progress over the set speed."""
    return np.asarray(-((1.0 - moment.progress / moment.speed) ** 2))


def turn_effort(moment: RoverMoment) -> FloatArray:
    """Minus the squared difference of the sides' demands."""
    return np.asarray(-((moment.demand_left - moment.demand_right) ** 2))


def misalignment(moment: RoverMoment) -> FloatArray:
    """Minus the squared angle between the direction of travel and the path [rad2]."""
    return np.asarray(-((moment.heading_error + moment.slip_angle) ** 2))


PARTS: Final = (cross_track_error, off_path, slowness, turn_effort, misalignment)

# 0.1 m off the path costs 1 a step, standing still 0.1
USUAL: Final[Mapping[RoverReward, float]] = {cross_track_error: 1.0, slowness: 0.1, turn_effort: 0.01}
MISHAP: Final = -100.0  # once


FIRM: Final = "none"  # the soil of hard ground
_SANDS: Final = ("toyoura_sand", "beach_sand")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverDomain(Ranges):
    """Ranges of a rover's episodes."""

    cross_fall: Range = drawn_from((-0.12, 0.12), -0.4, 0.4)  # rise to the left: up to 7 deg to either side [-]
    grade: Range = drawn_from((-0.05, 0.05), -0.4, 0.4)  # rise ahead [-]
    speed: Range = drawn_from((0.05, 0.12), 0.01, 1.0)  # set speed of the wheels [m/s]
    curvature: Range = drawn_from((-0.25, 0.25), -1.0, 1.0)  # of the path after its straight start [1/m]
    sensor_error: Range = drawn_from((0.5, 1.5), 0.0, 10.0)  # of the surrogate's slip angle, over the nominal error [-]


class RoverSteeringOptions(EpisodeOptions):
    """Options of the environment."""

    parts = PARTS

    vehicle: str = "el_dorado_ii_skid"  # name or file of a rover without steered wheels
    soils: Sequence[str] | None = None  # "none": firm ground; None: two sands and, except for ``estimate``, firm ground
    observation: ObservationKind = "surrogate"
    # Scenario with camera, sand and slip estimator, for ``estimate`` and ``camera``
    sensing: str | RoverScenario = "rover-slope"
    image_scale: int = 1  # factor that reduces images, for ``camera``
    domain: RoverDomain = RoverDomain()
    reward: Mapping[RoverReward, float] | None = None  # None: ``USUAL``
    engine: Engine = "auto"

    def soil_names(self) -> tuple[str, ...]:
        """Names of the soils.

        Raises:
            ValueError: one line, if there is none, or firm ground although the trace is observed.
        """
        needs_trace = self.observation == "estimate"
        names = self.soils if self.soils is not None else _SANDS if needs_trace else (*_SANDS, FIRM)
        if not names:
            raise ValueError("soils is empty: it must have at least one")
        if needs_trace and FIRM in names:
            raise ValueError("soils has 'none': firm ground takes no trace, which observation = 'estimate' needs")
        return tuple(names)

    def scenario(self, step: int) -> RoverScenario | None:
        """Scenario that gives the sensors, for control steps of ``step`` ticks; None without a camera.

        Raises:
            ValueError: one line, if it is a trailer's, or its sensors do not fit.
        """
        if self.observation not in ("estimate", "camera"):
            return None
        scenario = load_any_scenario(self.sensing) if isinstance(self.sensing, str) else self.sensing
        scenario = of_kind(
            scenario, RoverScenario, f"sensing: scenario {scenario.name} is a trailer's: this is for rovers"
        )
        if self.observation == "estimate" and scenario.slip_estimator == "truth":
            raise ValueError(f"sensing: scenario {scenario.name} has slip_estimator = truth; use observation = 'truth'")
        check_schedule(rig_schedule(scenario.rig, PERIOD), step, step_name="the control step, ")
        return scenario
