"""Surroundings of a country airfield: patched tarmac and fields of grain."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.world.ground import Centreline, Landscape, RoadMap
from sensors.world.scenery import Instances
from sensors.world.shapes import Mesh, cards, grid_faces, smooth_normals
from sensors.world.things import TWIGS_RANGE, Colour, Part, Thing
from vehicle.frames import FloatArray

_BED = 8.0  # side of a square bed of crop [m]
_NODES = 6  # of the mesh along a side, edges included
_HEIGHT = 0.75  # of ripe wheat [m]
_UNEVENNESS = 0.04  # standard deviation of the top of the crop [m]
_EARS = 60  # tufts above a bed
_VERGE = 2.0  # of grass between a road and the crop [m]
_REACH = 55.0  # of the fields beyond the verge [m]
_MAX_BEDS = 1500  # limits the number of triangles of a long course
_PATCHES = (0.4, 3.0)  # sides of patches [m]
_RIPE: Colour = (2.5, 1.45, 0.95)  # turns the green of leaves into straw


def patched(rng: np.random.Generator, road: RoadMap, per_100_m2: float) -> RoadMap:
    """The map with rectangular patches of different wear on the road."""
    ny, nx = road.edge_distance.shape
    count = round(per_100_m2 * 1e-2 * road.cell**2 * nx * ny)
    wear = road.gravel.copy()
    centres = rng.uniform(size=(count, 2)) * np.array([nx, ny])
    sides = np.exp(rng.uniform(math.log(_PATCHES[0]), math.log(_PATCHES[1]), size=(count, 2))) / road.cell
    turns = rng.uniform(0.0, 90.0, size=count)
    for centre, side, turn, worn in zip(centres, sides, turns, rng.uniform(0.0, 1.0, size=count), strict=True):
        corners = cv2.boxPoints((centre.tolist(), side.tolist(), float(turn)))
        cv2.fillConvexPoly(wear, np.round(corners * 16.0).astype(np.int32), float(worn), shift=4)
    return replace(road, gravel=np.where(road.edge_distance < 0.0, wear, road.gravel).astype(np.float32))


def grain_fields(rng: np.random.Generator, line: Centreline, landscape: Landscape) -> Instances:
    """Beds of ripe grain on a lattice, clear of the road and within reach of it."""
    nearest = line.greatest_half_width + _VERGE + np.sqrt(0.5) * _BED
    low, high = line.points.min(axis=0) - nearest - _REACH, line.points.max(axis=0) + nearest + _REACH
    axes = [np.arange(low[i], high[i], _BED) for i in range(2)]
    places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    distance = line.distance(places)
    order = np.argsort(distance)
    kept = order[(distance[order] > nearest) & (distance[order] < nearest + _REACH)][:_MAX_BEDS]
    bed = _bed(rng)
    return Instances(
        thing=bed,
        poses=_poses(rng, places[kept], landscape),
        brightness=1.0 + bed.variety * rng.uniform(-1.0, 1.0, len(kept)),
    )


def _poses(rng: np.random.Generator, places: FloatArray, landscape: Landscape) -> FloatArray:
    """Poses upright on the ground, turned by random multiples of 90 deg, so that neighbours differ."""
    turns = rng.integers(4, size=len(places))
    c, s = np.array([1.0, 0.0, -1.0, 0.0])[turns], np.array([0.0, 1.0, 0.0, -1.0])[turns]
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = c, -s, s, c
    poses[:, :2, 3], poses[:, 2, 3] = places, landscape.height(places)
    return poses


def _bed(rng: np.random.Generator) -> Thing:
    """One bed: an uneven top with sides down to the ground, and ears above it."""
    top = _top(rng)
    xy = rng.uniform(-0.48 * _BED, 0.48 * _BED, size=(_EARS, 2))
    places = np.column_stack([xy, np.full(_EARS, _HEIGHT)])
    upwards = np.tile(np.array([0.0, 0.0, 1.0]), (_EARS, 1))
    ears = cards(rng, places, upwards, 0.4, np.full(_EARS, 0.95))
    straw = Part(mesh=top, texture="foliage", colour=_RIPE)
    awns = Part(mesh=ears, texture="twigs", colour=_RIPE, distances=(0.0, TWIGS_RANGE))
    return Thing(name="grain", parts=(straw, awns), variety=0.12)


def _top(rng: np.random.Generator) -> Mesh:
    side = np.linspace(-0.5 * _BED, 0.5 * _BED, _NODES)
    side = np.concatenate([side[:1], side, side[-1:]])  # the outermost nodes twice: at the top and in the ground
    x, y = np.meshgrid(side, side, indexing="ij")
    z = np.where(_inside(len(side)), _HEIGHT + _UNEVENNESS * rng.standard_normal(x.shape), -0.5)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    level = np.stack([x, y, np.where(z > 0.0, z, _HEIGHT)], axis=-1).reshape(-1, 3)
    faces = grid_faces(len(side), len(side))
    return Mesh(
        vertices=vertices,
        normals=smooth_normals(level, faces),  # lit without the edges of the bed
        uv=np.stack([x + 0.7 * z, y + 0.7 * z], axis=-1).reshape(-1, 2) / 1.6,
        shade=np.where(z > 0.0, 0.95, 0.35).ravel(),
        faces=faces,
    )


def _inside(nodes: int) -> NDArray[np.bool_]:
    inside = np.zeros((nodes, nodes), dtype=bool)
    inside[1:-1, 1:-1] = True
    return inside
