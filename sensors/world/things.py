"""Roadside things: their data type, and the small ones: rocks, fences, posts, lamps, signs, kerb stones.

Sizes are those of real things [m]. The generator passed to a builder decides the irregularities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sensors.world.shapes import Mesh, blob, box, joined, pole, polygon

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
KERB_LENGTH = 0.914  # a British kerb stone, BS EN 1340 [m]
FENCE_LENGTH = 2.5  # [m]
TWIGS_RANGE = 50.0  # farther away twigs are smaller than a pixel [m]
_JOINTS_RANGE = 30.0  # farther away the joints of kerb stones are invisible [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One mesh of a thing with the texture that covers it."""

    mesh: Mesh
    texture: str  # a key of World.textures
    colour: Colour = WHITE  # multiplies the texture
    distances: tuple[float, float] = (0.0, math.inf)  # nearest and farthest at which it is drawn [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A kind of object."""

    name: str
    parts: tuple[Part, ...]
    variety: float  # spread of brightness between individuals, 0..1

    @property
    def nearest_parts(self) -> tuple[Part, ...]:
        """Parts that are drawn at close range."""
        return tuple(part for part in self.parts if part.distances[0] == 0.0)

    @property
    def radius(self) -> float:
        """Radius [m] of the smallest vertical cylinder around the thing."""
        return max(part.mesh.radius for part in self.parts)


def rock(rng: np.random.Generator) -> Thing:
    """A boulder of half a metre, partly in the ground."""
    lump = blob(rng, (0.0, 0.0, 0.1), (0.55, 0.4, 0.36), sides=7, roughness=0.12, texture_size=1.2)
    return Thing(name="rock", parts=(Part(mesh=lump, texture="stone", colour=(0.8, 0.78, 0.74)),), variety=0.2)


def fence() -> Thing:
    """One length of a wooden fence along x: a post and two rails."""
    half = FENCE_LENGTH / 2
    post = box((-0.06, 0.06), (-0.06, 0.06), (-0.5, 1.15), texture_size=0.8)
    rails = [box((-half, half), (0.06, 0.10), (z, z + 0.12), texture_size=0.8) for z in (0.45, 0.90)]
    return Thing(name="fence", parts=(Part(mesh=joined(post, *rails), texture="planks"),), variety=0.15)


def marker_post() -> Thing:
    """A white delineator with its black band, 1.1 m high."""
    mesh = box((-0.06, 0.06), (-0.05, 0.05), (-0.3, 1.1), texture_size=1.2)
    return Thing(name="marker_post", parts=(Part(mesh=mesh, texture="banded"),), variety=0.08)


def lamp() -> Thing:
    """A street lamp of 7 m with a short arm."""
    stem = pole((0.09, -0.3), (0.05, 7.0), sides=8)
    arm = box((-0.04, 1.4), (-0.04, 0.04), (6.94, 7.02), texture_size=1.0)
    head = box((0.9, 1.6), (-0.12, 0.12), (6.86, 7.0), texture_size=1.0)
    part = Part(mesh=joined(stem, arm, head), texture="stone", colour=(0.62, 0.65, 0.66))
    return Thing(name="lamp", parts=(part,), variety=0.05)


def bend_sign() -> Thing:
    """A chevron board on two posts, 2 m wide, readable from both sides."""
    posts = [box((-0.04, 0.04), (y - 0.04, y + 0.04), (-0.4, 1.5), texture_size=1.0) for y in (-0.7, 0.7)]
    board = box((-0.06, -0.03), (-1.0, 1.0), (0.75, 1.45), texture_size=0.7)
    back = box((0.03, 0.06), (-1.0, 1.0), (0.75, 1.45), texture_size=0.7)
    metal = Part(mesh=joined(*posts), texture="stone", colour=(0.55, 0.56, 0.57))
    return Thing(name="bend_sign", parts=(metal, Part(mesh=joined(board, back), texture="chevrons")), variety=0.05)


def kerb_stone() -> Thing:
    """A kerb stone along x, 125 mm wide with its traffic face at -y, 100 mm proud, its upper edge chamfered."""
    half = KERB_LENGTH / 2 - 0.004
    low, high, front, back = -0.05, 0.10, -0.01, 0.125
    profile = [(back, low), (back, high), (front + 0.03, high), (front, high - 0.05), (front, low)]  # along -x
    strips = []
    for (y0, z0), (y1, z1) in pairwise(profile):
        strip = np.array([[-half, y1, z1], [half, y1, z1], [half, y0, z0], [-half, y0, z0]])
        strips.append(polygon(strip, texture_size=0.9))
    ends = [np.array([[x, y, z] for y, z in profile]) for x in (half, -half)]
    caps = [polygon(ends[0], texture_size=0.9, shade=0.5), polygon(ends[1][::-1], texture_size=0.9, shade=0.5)]
    colour = (0.95, 0.94, 0.91)
    near = Part(mesh=joined(*strips, *caps), texture="stone", colour=colour, distances=(0.0, _JOINTS_RANGE))
    far = Part(mesh=joined(*strips), texture="stone", colour=colour, distances=(_JOINTS_RANGE, math.inf))
    return Thing(name="kerb_stone", parts=(near, far), variety=0.12)
