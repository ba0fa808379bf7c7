"""Warnings about what lies beside or beyond the course, so that the vehicle never meets it.

The vehicle is taken to keep to the course, with its rear behind the start. A place beside the course that is nearer
than the vehicle is long counts as met, as trailers cut corners.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from PIL import Image

from controllers.path import Path
from scenarios.options.scenario import RoverSurfaceOptions, Scenario
from scenarios.options.tables import CircleOptions, RectangleOptions
from vehicle.frames import FloatArray
from vehicle.rover.terrain import HeightMap

_SPACING: Final = 0.5  # between points of the course [m]
_MOUND: Final = 3.0  # radii at which a mound has hardly any height left [-]


class _Region(NamedTuple):
    """A rectangle with rounded corners in W."""

    key: str
    x: float  # of its centre [m]
    y: float  # [m]
    length: float  # along the heading [m]
    width: float  # [m]
    heading: float = 0.0  # [rad]
    rounding: float = 0.0  # added on all sides [m]

    def distance(self, points: FloatArray) -> float:
        """Least distance of points (n, 2) [m]."""
        x, y = (points - (self.x, self.y)).T
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        along = np.abs(cos * x + sin * y) - 0.5 * self.length
        across = np.abs(cos * y - sin * x) - 0.5 * self.width
        outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) - self.rounding
        return float(outside.min())


def unreached(scenario: Scenario, path: Path, length: float) -> tuple[str, ...]:
    """A line for each patch, image and gust of a trailer's scenario that its course does not meet.

    Args:
        scenario: the scenario.
        path: of the guided point.
        length: of the straight combination, whose front is guided [m].
    """
    points = _driven(path, length)
    wind = scenario.wind
    lines = list(_lines(_regions(scenario), points, length))
    if wind.speed:
        lines += _beyond(
            f"wind.start = {wind.start:g} m", "the gust", points, wind.start, wind.start + wind.length, 0.0
        )
    return tuple(lines)


def rover_unreached(
    surface: RoverSurfaceOptions, path: Path, heights: HeightMap | None, length: float
) -> tuple[str, ...]:
    """A line for each slope, mound and map of heights that a rover's path does not meet.

    Args:
        surface: the ground.
        path: of the rover's centre.
        heights: the map of ``surface.height_map`` if there is one.
        length: of the rover [m].
    """
    points = path.points(0.1 * _SPACING)
    regions = [
        _Region(f"surface.mounds.{k}", mound.x, mound.y, 0.0, 0.0, rounding=_MOUND * mound.radius)
        for k, mound in enumerate(surface.mounds)
    ]
    if surface.height_map and heights is not None:
        rows, columns = heights.heights.shape
        width, depth = heights.spacing * (columns - 1), heights.spacing * (rows - 1)
        regions.append(_Region("surface.height_map", heights.x + 0.5 * width, heights.y + 0.5 * depth, width, depth))
    lines = list(_lines(regions, points, length))
    begin, end = surface.slope_from, float(points[:, 0].max())
    if begin is not None and (surface.grade or surface.cross_fall):
        key = f"surface.slope_from = {begin:g} m"
        short = list(_beyond(key, "the slope", points, begin, math.inf, length))
        if not short and end < begin + surface.slope_over:
            short = [
                f"{key}: the course ends at x = {end:g} m, before the slope is complete at "
                f"{begin + surface.slope_over:g} m: lengthen it, or let the slope begin earlier"
            ]
        lines += short
    return tuple(lines)


def _driven(path: Path, length: float) -> FloatArray:
    """Points of the course, and of a straight line behind its start."""
    x, y, psi = path.start[:3]
    behind = np.arange(0.0, length, _SPACING)[:, None] * (math.cos(psi), math.sin(psi))
    return np.concatenate([(x, y) - behind, path.points(_SPACING)])


def _regions(scenario: Scenario) -> Iterator[_Region]:
    surface = scenario.surface
    for k, patch in enumerate(surface.patches):
        yield _patch(f"surface.patches.{k}", patch)
    if surface.friction_image is not None:
        with Image.open(surface.friction_image) as image:
            width, height = (surface.friction_image_scale * size for size in image.size)
        x, y = surface.friction_image_x + 0.5 * width, surface.friction_image_y + 0.5 * height
        yield _Region("surface.friction_image", x, y, width, height)


def _patch(key: str, patch: CircleOptions | RectangleOptions) -> _Region:
    if isinstance(patch, CircleOptions):
        return _Region(key, patch.x, patch.y, 0.0, 0.0, rounding=patch.radius + 0.5 * patch.edge)
    heading, edge = math.radians(patch.heading_deg), 0.5 * patch.edge
    return _Region(key, patch.x, patch.y, patch.length, patch.width, heading, edge)


def _lines(regions: Sequence[_Region] | Iterator[_Region], points: FloatArray, reach: float) -> Iterator[str]:
    (x_low, y_low), (x_high, y_high) = points.min(axis=0), points.max(axis=0)
    extent = f"the course spans x = {x_low:.1f} .. {x_high:.1f} m, y = {y_low:.1f} .. {y_high:.1f} m"
    for region in regions:
        if (distance := region.distance(points)) > reach:
            place = f"centre x = {region.x:g} m, y = {region.y:g} m"
            yield f"{region.key} ({place}): lies {distance:.1f} m beside the course and is never met; {extent}"


def _beyond(key: str, name: str, points: FloatArray, begin: float, end: float, reach: float) -> Iterator[str]:
    """A line if points do not come to a stretch of W's x axis."""
    low, high = float(points[:, 0].min()), float(points[:, 0].max())
    if begin > high + reach or end < low - reach:
        yield f"{key}: the course goes from x = {low:.1f} to {high:.1f} m: {name} is never met"
