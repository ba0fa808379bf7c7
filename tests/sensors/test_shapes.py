"""Meshes of overlapping lumps: what is inside of others is left out, and nothing else."""

from __future__ import annotations

import numpy as np

from sensors.world.things import Mesh, blob, inside, massed


def ball(x: float, radius: float = 1.0) -> Mesh:
    """A ball about (x, 0, 0), as 12 meridians and 8 rings."""
    rng = np.random.default_rng(0)
    return blob(rng, (x, 0.0, 0.0), (radius, radius, radius), rings=8, sides=12, roughness=0.0)


def test_a_ball_encloses_what_is_nearer_than_its_radius() -> None:
    """But for the sagitta of its facets."""
    points = np.random.default_rng(1).uniform(-1.5, 1.5, size=(2000, 3))
    r = np.linalg.norm(points, axis=1)
    enclosed = inside(ball(0.0), points)
    assert enclosed[r < 0.93].all()  # cos(pi/12) cos(pi/16) = 0.95
    assert not enclosed[r > 1.0].any()


def test_hidden_triangles_are_left_out() -> None:
    """Of two balls half a radius apart neither has a triangle well inside the other; the outside stays closed."""
    balls = ball(-0.25), ball(0.25)
    mass = massed(*balls)
    middles = mass.vertices[mass.faces].mean(axis=1)
    for other, x in zip(balls, (-0.25, 0.25), strict=True):
        deep = np.linalg.norm(middles - [x, 0.0, 0.0], axis=1) < 0.7
        assert not deep.any()
        corners = other.vertices[other.faces]
        seen = (np.linalg.norm(corners + np.array([x, 0.0, 0.0]), axis=2) > 1.0).all(axis=1)  # out of the other ball
        seen &= np.linalg.norm(np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)), axis=1) > 0.0  # poles have no area
        kept = np.linalg.norm(corners[seen].mean(axis=1)[:, None] - middles, axis=2).min(axis=1)
        assert kept.max() < 1e-9


def test_a_ball_within_another_is_never_seen() -> None:
    """Nothing is left of the smaller one."""
    outer = ball(0.0)
    assert np.abs(massed(outer, ball(0.1, 0.4)).vertices).max() == np.abs(outer.vertices).max()
    assert len(massed(outer, ball(0.1, 0.4)).faces) == len(massed(outer).faces)
