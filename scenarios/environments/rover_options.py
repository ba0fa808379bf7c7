"""What an episode of ``RoverSteering`` is drawn from, and what there is to choose when it is made."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from scenarios.environments.domain import Range, drawn_within
from scenarios.environments.knowledge import Knowledge
from scenarios.environments.sensed_slip import check_slip_sensing
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import load_any_scenario
from vehicle.engine.kernels import Engine

FIRM: Final = "none"  # the soil of hard ground
_SANDS: Final = ("toyoura_sand", "beach_sand")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverDomain:
    """What an episode's circumstances are drawn from.

    Raises:
        ValueError: if a range is empty or leaves its limits.
    """

    cross_fall: Range = (-0.12, 0.12)  # rise to the left: up to 7 deg to either side [-]
    grade: Range = (-0.05, 0.05)  # rise ahead [-]
    speed: Range = (0.05, 0.12)  # that the wheels are to turn for [m/s]
    curvature: Range = (-0.25, 0.25)  # of the path behind its straight start [1/m]
    sensor_error: Range = (0.5, 1.5)  # of the surrogate's slip angle, over the usual one [-]

    def __post_init__(self) -> None:
        drawn_within(self, LIMITS)


LIMITS: Final = {
    "cross_fall": (-0.4, 0.4),
    "grade": (-0.4, 0.4),
    "speed": (0.01, 1.0),
    "curvature": (-1.0, 1.0),
    "sensor_error": (0.0, 10.0),
}


@dataclass(frozen=True, kw_only=True)
class RoverSteeringOptions:
    """What there is to choose when the environment is made."""

    vehicle: str = "el_dorado_ii_skid"  # name or file of a rover without steered wheels
    soils: tuple[str, ...] | None = None  # "none": firm ground; None: two sands and, but for ``estimate``, firm ground
    observation: Knowledge = "surrogate"
    sensing: str | RoverScenario = "rover-slope"  # a scenario, whose camera, sand and slip estimator ``estimate`` has
    image_scale: int = 1  # pixels of a side that become one, for ``camera``
    domain: RoverDomain = field(default_factory=RoverDomain)
    engine: Engine = "auto"

    def soil_names(self) -> tuple[str, ...]:
        """The soils that there are.

        Raises:
            ValueError: one line, if there is none, or one in which nothing is to be seen.
        """
        sees = self.observation == "estimate"
        names = self.soils if self.soils is not None else _SANDS if sees else (*_SANDS, FIRM)
        if not names:
            raise ValueError("soils is empty: there must be one at least")
        if sees and FIRM in names:
            raise ValueError("soils has 'none': firm ground takes no trace that observation = 'estimate' could see")
        return names

    def scenario(self, step: int) -> RoverScenario | None:
        """Whose sensors there are, for control steps of so many ticks; None: none are looked through.

        Raises:
            ValueError: one line, if it is a trailer's, or its sensors do not fit.
        """
        if self.observation not in ("estimate", "camera"):
            return None
        scenario = load_any_scenario(self.sensing) if isinstance(self.sensing, str) else self.sensing
        if not isinstance(scenario, RoverScenario):
            raise ValueError(f"sensing: scenario {scenario.name} is a trailer's: this is for rovers")
        check_slip_sensing(scenario, estimates=self.observation == "estimate", step=step)
        return scenario
