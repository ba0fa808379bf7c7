"""Friction of the ground: uniform, by sides of the road, from an image, with patches."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, UnidentifiedImageError

from scenarios.options.surface import CircleOptions, RectangleOptions, SurfaceOptions
from vehicle.frames import FloatArray
from vehicle.surface import Friction, FrictionImage, PatchedFriction, SplitFriction, circle, rectangle
from vehicle.surface.patches import Patch


def ground_friction(options: SurfaceOptions, centreline: FloatArray) -> Friction:
    """The friction of the ground around a road with that centreline (n, 2) [m].

    Raises:
        ValueError: one line, if the image cannot be read.
    """
    friction: Friction = options.friction
    left, right = options.friction_left, options.friction_right
    if left is not None or right is not None:
        left, right = (options.friction if side is None else side for side in (left, right))
        friction = SplitFriction(left, right, line=centreline)
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
        with Image.open(path) as image:
            grey = np.asarray(image.convert("L"), dtype=np.float64) / 255.0
    except UnidentifiedImageError:
        raise ValueError(f"surface.friction_image = {path}: not a readable image (PNG, JPEG, ...)") from None
    except OSError as error:
        raise ValueError(f"surface.friction_image = {path}: {error.strerror or error}") from None
    return black + (white - black) * grey


def _patch(table: CircleOptions | RectangleOptions) -> Patch:
    if isinstance(table, CircleOptions):
        return circle(table.x, table.y, table.radius, table.friction, table.edge)
    heading = math.radians(table.heading_deg)
    return rectangle(table.x, table.y, table.length, table.width, table.friction, heading, table.edge)
