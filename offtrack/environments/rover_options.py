"""Options of ``RoverSteering``: parts of its reward, and the ranges that its episodes are drawn from.

A mapping from part to weight is the option ``reward``; it may hold your own functions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from offtrack.environments.core import CHECKED
from offtrack.environments.domain import Range, Ranges, drawn_from
from offtrack.environments.observations import ObservationKind
from offtrack.environments.rover_observations import check_slip_sensing
from scenarios.options.rover_scenario import RoverScenario
from scenarios.options.scenario import load_any_scenario, of_kind
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray


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


# 0.1 m off the path costs 1 a step, standing still 0.1
USUAL: Final[Mapping[RoverReward, float]] = {cross_track_error: 1.0, slowness: 0.1, turn_effort: 0.01}
MISHAP: Final = -100.0  # once


FIRM: Final = "none"  # the soil of hard ground
_SANDS: Final = ("toyoura_sand", "beach_sand")


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class RoverDomain(Ranges):
    """Ranges of a rover's episodes."""

    cross_fall: Range = drawn_from((-0.12, 0.12), -0.4, 0.4)  # rise to the left: up to 7 deg to either side [-]
    grade: Range = drawn_from((-0.05, 0.05), -0.4, 0.4)  # rise ahead [-]
    speed: Range = drawn_from((0.05, 0.12), 0.01, 1.0)  # set speed of the wheels [m/s]
    curvature: Range = drawn_from((-0.25, 0.25), -1.0, 1.0)  # of the path after its straight start [1/m]
    sensor_error: Range = drawn_from((0.5, 1.5), 0.0, 10.0)  # of the surrogate's slip angle, over the nominal error [-]


@dataclass(frozen=True, kw_only=True, config=CHECKED)
class RoverSteeringOptions:
    """Options of the environment."""

    vehicle: str = "el_dorado_ii_skid"  # name or file of a rover without steered wheels
    soils: Sequence[str] | None = None  # "none": firm ground; None: two sands and, except for ``estimate``, firm ground
    observation: ObservationKind = "surrogate"
    sensing: str | RoverScenario = (
        "rover-slope"  # scenario with camera, sand and slip estimator, for ``estimate`` and ``camera``
    )
    image_scale: int = 1  # factor that reduces images, for ``camera``
    domain: RoverDomain = dataclasses.field(default_factory=RoverDomain)
    reward: Mapping[RoverReward, float] | None = None  # None: ``rover_rewards.USUAL``
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
        check_slip_sensing(scenario, estimates=self.observation == "estimate", step=step)
        return scenario
