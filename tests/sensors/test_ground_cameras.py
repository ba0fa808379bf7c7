"""Cameras under the trailer: where they look, and ground that wheels leave different."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sensors.camera.rig import StereoCalibration, ground_watching_pair
from sensors.messages import ColourImage
from sensors.world.world import ReformedGround
from vehicle.frames import FloatArray, rotation_zyx, transform
from vehicle.surface import Surface

RIG = ground_watching_pair(200, 160, math.radians(70.0), front_x=-1.5, rear_x=-13.5, z=1.0)
WHEELS = np.array([[-8.0, 1.0], [-8.0, -1.0]])
FLAT = Surface(friction=0.8)


class PaintedGround:
    """A source whose pixels carry where on the ground they look, W of x and y in centimetres modulo 256."""

    calibration = RIG

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        X_WCl = X_WB @ self.calibration.X_SC
        left, right = (painted(self.calibration, X_WC) for X_WC in (X_WCl, X_WCl @ self.calibration.X_ClCr))
        return left, right


def looked_at(c: StereoCalibration, X_WC: FloatArray) -> FloatArray:
    """W of the ground z = 0 behind every pixel (height, width, 2) [m]."""
    v, u = np.mgrid[0 : c.height, 0 : c.width]
    rays = np.stack([(u - c.cx) / c.focal_length, (v - c.cy) / c.focal_length, np.ones(u.shape)], axis=-1)
    along = rays @ X_WC[:3, :3].T
    return np.asarray(X_WC[:2, 3] - X_WC[2, 3] / along[..., 2:] * along[..., :2])


def painted(c: StereoCalibration, X_WC: FloatArray) -> ColourImage:
    centimetres = np.floor(100.0 * looked_at(c, X_WC)) % 256
    return np.concatenate([centimetres, np.zeros((c.height, c.width, 1))], axis=-1).astype(np.uint8)


def body(x: float, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    return transform(rotation_zyx(yaw, 0.0, 0.0), np.array([x, y, 0.0]))


def test_both_cameras_look_straight_down_from_where_they_hang() -> None:
    """The middle of each image is the ground right below; columns run to the rear, rows to the left."""
    c = RIG
    for X_SC, x in ((c.X_SC, -1.5), (c.X_SC @ c.X_ClCr, -13.5)):
        seen = looked_at(c, X_SC)
        np.testing.assert_allclose(seen.mean(axis=(0, 1)), [x, 0.0], atol=1e-9)
        assert seen[80, 150, 0] < seen[80, 50, 0]
        assert seen[120, 100, 1] > seen[40, 100, 1]
    width = 2.0 * math.tan(math.radians(35.0)) * 199 / 200  # between the centres of the outer pixels, 1 m up
    assert np.ptp(looked_at(c, c.X_SC)[..., 0]) == pytest.approx(width)


def driven(ground: ReformedGround, way: float) -> tuple[ColourImage, ColourImage]:
    for x in np.arange(0.0, way, 0.5):
        ground.render(body(x))
    return ground.render(body(way))


def test_only_what_wheels_have_rolled_on_looks_different() -> None:
    """At y = +-0.5 m wheels 0.4 m wide leave strips in the rear view; the front camera is ahead of them."""
    ground = ReformedGround(PaintedGround(), FLAT, [np.array([[-8.0, 0.5], [-8.0, -0.5]])], width=0.4)
    left, right = driven(ground, 20.0)
    plain_left, plain_right = PaintedGround().render(body(20.0))
    np.testing.assert_array_equal(left, plain_left)
    different = (right != plain_right).any(axis=-1)
    y = looked_at(RIG, body(20.0) @ RIG.X_SC @ RIG.X_ClCr)[..., 1]
    pixel = 0.008  # two pixels: drawn lines have round ends and whole thicknesses [m]
    assert different[np.abs(np.abs(y) - 0.5) < 0.2 - pixel].all()
    assert not different[np.abs(np.abs(y) - 0.5) > 0.2 + pixel].any()


def test_reformed_ground_stays_where_it_is() -> None:
    ground = ReformedGround(PaintedGround(), FLAT, [WHEELS], width=2.2)
    _, before = driven(ground, 20.0)
    c = RIG
    shift = round(0.1 * c.focal_length)  # 10 cm at 1 m [px]
    _, after = ground.render(body(20.0 + shift / c.focal_length))
    same = (before[:, :-shift].astype(int) - after[:, shift:].astype(int))[..., :2]
    assert (np.abs(same) <= 1).mean() > 0.99  # whole centimetres may flip by rounding


def test_flowing_ground_moves_along_with_the_vehicle() -> None:
    """At a tenth of the vehicle's velocity a pattern passes the camera at nine tenths of it."""
    ground = ReformedGround(PaintedGround(), FLAT, [WHEELS], width=2.2, flow=0.1)
    _, before = driven(ground, 20.0)
    _, after = ground.render(body(20.5))
    moved = (after[80, 100, 0].astype(int) - before[80, 100, 0].astype(int)) % 256
    assert moved == pytest.approx(45, abs=1)  # [cm]


def test_ground_that_one_group_left_is_changed_again_by_the_next() -> None:
    """Two groups on the same strip: what the rear camera sees is neither as it was nor as the first one left it."""
    first, second = (np.array([[x, 0.0]]) for x in (-4.0, -8.0))
    pictures = [
        driven(ReformedGround(PaintedGround(), FLAT, groups, width=2.2), 20.0)[1]
        for groups in ([first], [first, second])
    ]
    middle = [picture[80, 100, :2].astype(int) for picture in (PaintedGround().render(body(20.0))[1], *pictures)]
    assert not (middle[0] == middle[1]).all()
    assert not (middle[0] == middle[2]).all()
    assert not (middle[1] == middle[2]).all()


def test_more_groups_than_can_be_told_apart_are_refused() -> None:
    with pytest.raises(ValueError, match="3 groups of wheels: at most 2"):
        ReformedGround(PaintedGround(), FLAT, [WHEELS] * 3, width=1.0)
