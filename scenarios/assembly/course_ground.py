"""The ground of a run: the surface along the course, with its measured OpenCRG road."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from scenarios.assembly.adapters import surface_of
from scenarios.courses import Course
from scenarios.options.scenario import Scenario
from scenarios.options.surroundings import SurfaceOptions
from scenarios.randomness import stream
from scenarios.roads.crg_file import CrgSurface, read_crg
from vehicle.foundation.polyline import dense
from vehicle.frames import FloatArray
from vehicle.surface import PATCH_SPREAD, MeasuredRoad, Surface

_SPACING: Final = 0.25  # between points of the line [m]
_BEFORE_START: Final = 100.0  # length of line that holds the start of the path [m]
_HIGHEST: Final = 0.5  # unevenness that a wheel may roll over [m]


class MeasuredGround(NamedTuple):
    """A measured road, and what a user should know of it."""

    road: MeasuredRoad
    remarks: tuple[str, ...]


def measured_ground(options: SurfaceOptions, course: Course) -> MeasuredGround | None:
    """The surface of ``surface.crg`` along a course; None if there is none.

    Raises:
        ValueError: one line, if the file cannot be read, or has steps that no wheel rolls over.
    """
    if options.crg is None:
        return None
    try:
        surface = read_crg(Path(options.crg))
    except ValueError as error:
        raise ValueError(f"surface.crg = {error}") from None
    try:
        line, _ = dense(course.centreline, _SPACING)
        road = MeasuredRoad(
            line,
            surface.heights,
            u_step=surface.u_step,
            v=surface.v,
            start=options.crg_start + _path_start(line, course) + surface.u_start,
            beyond=options.crg_beyond,
            tyre_spread=PATCH_SPREAD,
        )
    except ValueError as error:
        raise ValueError(f"surface.crg = {options.crg}: {error}") from None
    if road.highest > _HIGHEST:
        raise ValueError(
            f"surface.crg = {options.crg}: is {road.highest:.2f} m higher or lower than its mean profile: must be at "
            f"most {_HIGHEST:g} m (heights are metres)"
        )
    return MeasuredGround(road, tuple(_remarks(surface, course)))


def _path_start(line: FloatArray, course: Course) -> float:
    """Station of the line beside which the guided point starts [m]."""
    first = line[: int(_BEFORE_START / _SPACING)]
    return int(np.argmin(np.hypot(*(first - np.array(course.path.start[:2])).T))) * float(math.dist(line[0], line[1]))


def _remarks(surface: CrgSurface, course: Course) -> list[str]:
    """One line for each way in which the file does not cover the road."""
    remarks = []
    if surface.missing:
        remarks.append(
            f"surface.crg: {100.0 * surface.missing:.2g} % of its heights are missing: filled in from beside"
        )
    left, right = np.broadcast_to(course.road_half_width, (len(course.centreline), 2)).max(axis=0).tolist()
    if surface.v[-1] < left - 0.01 or -surface.v[0] < right - 0.01:
        remarks.append(
            f"surface.crg: reaches from {surface.v[0]:.2f} to {surface.v[-1]:+.2f} m across, the road from "
            f"{-right:.2f} to {left:+.2f} m: beside it the height of its edge goes on"
        )
    return remarks


def opened_ground(scenario: Scenario, course: Course, seed: int) -> tuple[Surface, tuple[str, ...]]:
    """The surface of a scenario, whose roughness the seed decides, and what a user should know of its measured road.

    Raises:
        ValueError: one line, if a file cannot be read.
    """
    measured = measured_ground(scenario.surface, course)
    surface = surface_of(scenario, course, stream(seed, "surface"), measured.road if measured else None)
    return surface, measured.remarks if measured else ()
