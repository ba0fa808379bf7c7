"""Friction of the ground: uniform, by sides of the road, from an image, with patches."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from scenarios.image_file import read_grey
from scenarios.options.surface import CircleOptions, RectangleOptions, SurfaceOptions
from vehicle.frames import FloatArray
from vehicle.surface import Friction, FrictionImage, PatchedFriction, SplitFriction, circle, rectangle
from vehicle.surface.friction import Patch


def ground_friction(options: SurfaceOptions, centreline: FloatArray, measured: Friction | None = None) -> Friction:
    """The friction of the ground around a road with that centreline (n, 2) [m]; ``measured`` replaces the uniform one.

    Raises:
        ValueError: one line, if the image cannot be read.
    """
    friction: Friction = options.friction if measured is None else measured
    left, right = options.friction_left, options.friction_right
    if left is not None or right is not None:
        friction = SplitFriction(
            friction if left is None else left, friction if right is None else right, line=centreline
        )
    if options.friction_image is not None:
        friction = FrictionImage(
            _image_values(options.friction_image, options.friction_image_black, options.friction_image_white),
            cell=options.friction_image_scale,
            corner=(options.friction_image_x, options.friction_image_y),
            outside=friction,
        )
    return PatchedFriction(friction, [_patch(table) for table in options.patches]) if options.patches else friction


def _image_values(path: str, black: float, white: float) -> FloatArray:
    """Friction coefficients (ny, nx) of an image's grey values."""
    try:
        grey = read_grey(Path(path))
    except ValueError as error:
        raise ValueError(f"surface.friction_image = {error}") from None
    levels: FloatArray = black + (white - black) * (np.arange(256) / 255.0)
    return levels[grey]


def _patch(table: CircleOptions | RectangleOptions) -> Patch:
    if isinstance(table, CircleOptions):
        return circle(table.x, table.y, table.radius, table.friction, table.edge)
    heading = math.radians(table.heading_deg)
    return rectangle(table.x, table.y, table.length, table.width, table.friction, heading, table.edge)
