"""The ground of a run: the surface along the course, with its measured road."""

from __future__ import annotations

from scenarios.assembly.adapters import surface_of
from scenarios.assembly.measured_ground import measured_ground
from scenarios.courses import Course
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from vehicle.surface import Surface


def opened_ground(scenario: Scenario, course: Course, seed: int) -> tuple[Surface, tuple[str, ...]]:
    """The surface of a scenario, whose roughness the seed decides, and what a user should know of its measured road.

    Raises:
        ValueError: one line, if a file cannot be read.
    """
    measured = measured_ground(scenario.surface, course)
    surface = surface_of(scenario, course, stream(seed, "surface"), measured.road if measured else None)
    return surface, measured.remarks if measured else ()
