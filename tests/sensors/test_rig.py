"""Which way the rigs look, and what a raw rig is before anything is wrong with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sensors.camera.rig import UNDISTORTED, Facing, StereoRig, mount_rotation

RIG = StereoRig(facing="rear", width=672, height=240, hfov=math.radians(100.0), x=-13.6, y=0.2, z=3.0, baseline=0.5)


@pytest.mark.parametrize(
    ("facing", "ahead", "right"),
    [
        ("rear", (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ("left", (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        ("right", (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)),
        ("down", (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    ],
)
def test_cameras_look_where_they_are_said_to(
    facing: Facing, ahead: tuple[float, float, float], right: tuple[float, float, float]
) -> None:
    """Optical axis and image's x in the trailer (x ahead, y left, z up); what looks down has the way ahead on top."""
    rig = replace(RIG, facing=facing)
    c = rig.calibration()
    np.testing.assert_allclose(c.X_SC[:3, 2], ahead, atol=1e-12)
    np.testing.assert_allclose(c.X_SC[:3, 0], right, atol=1e-12)
    middle = 0.5 * (c.X_SC + c.X_SC @ c.X_ClCr)[:3, 3]
    np.testing.assert_allclose(middle, (-13.6, 0.2, 3.0), atol=1e-12)


def test_the_raw_rig_is_the_calibrated_one_with_its_faults() -> None:
    """Two equal pinholes without any; lenses and a turned right camera where it stands with them."""
    c, plain = RIG.calibration(), RIG.raw()
    assert plain.left == plain.right
    assert plain.left.distortion == UNDISTORTED
    np.testing.assert_array_equal(plain.X_ClCr, c.X_ClCr)
    np.testing.assert_array_equal(plain.left.matrix[:2, 2], [c.cx, c.cy])
    assert plain.left.fx == plain.left.fy == c.focal_length
    bent = RIG.raw((-0.05, 0.0, 0.0, 0.0, 0.0), mount_rotation(0.0, 0.002, 0.0))
    assert bent.right.distortion[0] == -0.05
    np.testing.assert_array_equal(bent.X_ClCr[:3, 3], c.X_ClCr[:3, 3])
    assert bent.X_ClCr[0, 2] == pytest.approx(math.sin(0.002))
