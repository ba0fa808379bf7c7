"""Subjects of studies: the scenario keys that are compared and tuned, of trailers and of rovers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from scenarios.catalogue import OFF_TRACKING, ROVER_DRIVER, SLIP_ESTIMATOR, TRAILER_STEERING, Catalogue
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import load_any_scenario


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Scenario keys of a kind of vehicle, with the defaults of ``compare`` and ``tune``."""

    compared: str  # key that ``compare --controllers`` varies
    controllers: tuple[str, ...]  # its values, if none are given
    estimator: str  # key of the estimator
    estimators: Catalogue
    tuned: str  # key of the part that ``tune`` tunes
    parts: Catalogue
    part: str  # tuned if none is given
    parameters: str  # table of its parameters
    objectives: tuple[str, ...]


TRAILER: Final = Subject(
    compared="trailer_steering",
    controllers=("none", "command_steer", "path_preview"),
    estimator="off_tracking",
    estimators=OFF_TRACKING,
    tuned="trailer_steering",
    parts=TRAILER_STEERING,
    part="path_preview",
    parameters="steering",
    objectives=("off_tracking.true_rms_m", "off_tracking.true_max_m"),
)
ROVER: Final = Subject(
    compared="slip_compensation",
    controllers=("none", "heading", "crab"),
    estimator="slip_estimator",
    estimators=SLIP_ESTIMATOR,
    tuned="driver",
    parts=ROVER_DRIVER,
    part="path",
    parameters="driving",
    objectives=("slip.cross_track_rms_m",),
)


def subject_of(scenario: str) -> Subject:
    """The subject of a scenario's studies.

    Raises:
        ValueError: one line, if there is no such scenario.
    """
    return ROVER if isinstance(load_any_scenario(scenario), RoverScenario) else TRAILER
