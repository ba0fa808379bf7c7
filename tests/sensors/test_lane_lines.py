"""Lines between lanes on the map of the road, and in pictures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from sensors.world.ground import Centreline, line_map, road_map
from sensors.world.world import World
from tests.sensors.test_ground_texture import from_above
from vehicle.frames import FloatArray


def arc_with_lines(radius: float = 30.0) -> tuple[FloatArray, FloatArray]:
    """A quarter of a circle about the origin, a broken line in its middle and a solid one 3.5 m to its right."""
    angles = np.arange(0.0, 0.5 * math.pi, 0.25 / radius)
    centre = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return centre, np.tile([[-3.5, 0.0], [0.0, 1.0]], (len(centre), 1, 1))


def test_the_map_holds_distances_from_lines() -> None:
    """Interpolated between its nodes: zero on both lines, right within 1 mm close to them, and no line elsewhere."""
    centre, lines = arc_with_lines()
    line = Centreline(centre, 6.0)
    road = road_map(np.random.default_rng(0), line, np.full(2, -10.0), np.full(2, 50.0))
    table = line_map(road, centre, lines)
    assert table is not None

    def at(radius: FloatArray, angle: FloatArray) -> FloatArray:
        xy = radius * np.stack([np.cos(angle), np.sin(angle)])
        nodes = (xy[::-1] - road.origin[::-1, None]) / road.cell
        return np.stack([map_coordinates(table[..., i], nodes, order=1) for i in range(2)])

    angles = np.linspace(0.1, 1.4, 400)
    for place in (30.0, 33.5):
        for aside in (-0.1, 0.0, 0.1):
            across, _ = at(place + aside + 0.0 * angles, angles)
            assert np.abs(np.abs(across) - abs(aside)).max() < 2e-3
    assert (at(33.5 + 0.0 * angles, angles)[1] > 0.0).all()
    painted = at(30.0 + 0.0 * angles, angles)[1] > 0.0
    along = 30.0 * angles
    assert painted == pytest.approx((along % 12.0 < 1.5) | (along % 12.0 > 10.5))
    everywhere = at(np.repeat(np.linspace(25.0, 35.0, 201), 400), np.tile(angles, 201)).reshape(2, 201, 400)
    radii = np.linspace(25.0, 35.0, 201)
    lined = ((np.abs(everywhere[0]) < 0.06) & (everywhere[1] > 0.0)).any(axis=1)
    assert radii[lined].tolist() == pytest.approx([29.95, 30.0, 30.05, 33.45, 33.5, 33.55])


def test_lines_are_seen_where_they_are(bare_world: World) -> None:
    """From above: two bright stripes 3.5 m apart, one of them with gaps, and nothing else differs from no lines."""
    edge = np.full_like(bare_world.road.edge_distance, -3.0)
    road = replace(bare_world.road, edge_distance=edge)
    centre = np.column_stack([np.arange(-30.0, 30.5, 0.5), np.zeros(121)])
    lines = np.tile([[-3.5, 0.0], [0.0, 1.0]], (len(centre), 1, 1))
    size = 320  # [px] for 20 m
    with_lines, without = (
        from_above(replace(bare_world, road=replace(road, lines=table)), height=20.0, size=size)
        for table in (line_map(road, centre, lines), None)
    )
    across = (with_lines - without).mean(axis=1)
    y = (0.5 * (size - 1) - np.arange(size)) / 16.0  # [m]
    solid, broken = (np.abs(y - place) < 0.1 for place in (-3.5, 0.0))
    assert across[solid].mean() > 30.0
    assert across[broken].mean() == pytest.approx(0.25 * across[solid].mean(), rel=0.4)  # 3 m of 12, 20 m in view
    assert np.abs(across[~(np.abs(y + 3.5) < 0.3) & ~(np.abs(y) < 0.3)]).max() == 0.0
