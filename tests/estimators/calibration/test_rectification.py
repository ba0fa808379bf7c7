"""Rectification: what both cameras see lies in one row, where the calibration says, and nothing is lost on the way."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from estimators.calibration.rectification import Rectifier
from estimators.stereo_pair import triangulate
from sensors.camera.rig import UNDISTORTED, CameraModel, Distortion, RawStereoRig
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, rotation_zyx, so3_exp, transform

BARREL = (-0.12, 0.02, 0.0006, -0.0004, -0.001)  # of a 100 deg lens


CAMERA = CameraModel(width=1344, height=391, fx=565.0, fy=563.0, cx=660.0, cy=201.0, distortion=BARREL)


def rig(turn: tuple[float, float, float] = (0.4, -0.6, 0.5), **changes: Any) -> RawStereoRig:
    """A rear-facing pair; the right camera is turned by ``turn`` [deg] and sits 5 mm off the left one's x axis."""
    X_SC = transform(
        rotation_zyx(np.pi, 0.02, 0.01) @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.array([-14.0, 0.25, 3.0])
    )
    X_ClCr = transform(so3_exp(np.radians(turn)), np.array([0.5, 0.004, -0.003]))
    right = replace(CAMERA, fx=561.0, cx=680.0, cy=190.0, distortion=(-0.11, 0.018, -0.0003, 0.0005, -0.001))
    return replace(RawStereoRig(left=CAMERA, right=right, X_ClCr=X_ClCr, X_SC=X_SC), **changes)


def points(n: int = 200) -> FloatArray:
    """Points (n, 3) ahead of the raw left camera, 4 to 40 m away [m]."""
    rng = np.random.default_rng(3)
    rays = rng.uniform([-0.85, -0.2], [0.85, 0.25], (n, 2))
    return np.column_stack([rays, np.ones(n)]) * rng.uniform(4.0, 40.0, (n, 1))


def spots(pixels: FloatArray, shape: tuple[int, int]) -> GreyImage:
    """A grey image of one smooth spot around the pixel (2,)."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    spot = np.exp(-((u - pixels[0]) ** 2 + (v - pixels[1]) ** 2) / (2.0 * 2.5**2))
    return np.asarray(np.rint(20.0 + 200.0 * spot), dtype=np.uint8)


def centre(image: GreyImage) -> FloatArray:
    weight = np.maximum(image.astype(np.float64) - 30.0, 0.0)
    v, u = np.indices(image.shape)
    middle: FloatArray = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    return middle


def in_body(raw: RawStereoRig, p: FloatArray) -> FloatArray:
    return p @ raw.X_SC[:3, :3].T + raw.X_SC[:3, 3]


def test_spots_lie_in_one_row_and_where_their_depth_says() -> None:
    """Drawn through both lenses, rectified, triangulated: back at the point in the trailer's axes that was drawn."""
    raw = rig()
    rectifier = Rectifier(raw)
    c = rectifier.calibration
    for p in points(6):
        p_Cr = (p - raw.X_ClCr[:3, 3]) @ raw.X_ClCr[:3, :3]
        left = spots(raw.left.project(p[None])[0], (391, 1344))
        right = spots(raw.right.project(p_Cr[None])[0], (391, 1344))
        frame = rectifier.step(StereoFrame(tick=7, left=left, right=right))
        seen, seen_right = centre(frame.left), centre(frame.right)
        assert (
            abs(seen[1] - seen_right[1]) < 0.03
        )  # the curvature of the lens over a spot; OpenCV 4 also rounds to 1/32 px [px]
        z = np.array([seen[0], 0.5 * (seen[1] + seen_right[1]), seen_right[0]])
        found = c.X_SC[:3, :3] @ triangulate(c, z) + c.X_SC[:3, 3]
        # 0.03 px of disparity are this much of depth, seen from the camera; lateral errors are far smaller
        depth = float(p[2])
        assert np.linalg.norm(found - in_body(raw, p)) < 0.03 * depth**2 / (c.focal_length * c.baseline) + 0.003
        assert frame.tick == 7


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.6, 0.5), (-3.0, 2.0, 4.0)])
@pytest.mark.parametrize("distortion", [UNDISTORTED, BARREL, (0.12, 0.02, 0.0, 0.0, 0.0)])
def test_the_rectified_image_shows_nothing_that_a_camera_does_not(
    turn: tuple[float, float, float], distortion: Distortion
) -> None:
    """White raw images stay white to the corners: no invented edge for a corner detector to find."""
    raw = rig(turn, left=replace(CAMERA, distortion=distortion))
    rectifier = Rectifier(raw)
    white = np.full((391, 1344), 255, np.uint8)
    for map_ in rectifier._maps:
        assert map_ is not None
        outside = cv2.remap(white, *map_, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        assert outside.min() > 250  # the last row of pixels is met to 1/32 px
    c = rectifier.calibration
    assert (c.width, c.height) == (1344, 391)
    assert c.baseline == pytest.approx(raw.baseline)
    assert 561.0 < c.focal_length < 1.6 * 565.0  # the scale of the cameras, or a little more


def test_a_pair_that_is_rectified_already_is_left_alone() -> None:
    plain = CameraModel(width=640, height=400, fx=500.0, fy=500.0, cx=320.0, cy=200.0)
    raw = RawStereoRig(left=plain, right=plain, X_ClCr=transform(np.eye(3), np.array([0.5, 0, 0])), X_SC=rig().X_SC)
    rectifier = Rectifier(raw)
    image = np.random.default_rng(0).integers(0, 255, (400, 640), dtype=np.uint8)
    colour = np.repeat(image[..., None], 3, axis=2)
    frame = rectifier.step(StereoFrame(tick=0, left=image, right=image, colour=colour))
    assert frame.left is image
    assert frame.right is image
    assert frame.colour is colour
    c = rectifier.calibration
    assert (c.focal_length, c.cx, c.cy, c.baseline) == (500.0, 320.0, 200.0, 0.5)
    np.testing.assert_allclose(c.X_SC, raw.X_SC, atol=1e-15)


def test_colour_for_people_is_rectified_with_the_left_image() -> None:
    raw = rig()
    left = spots(raw.left.project(points(1))[0], (391, 1344))
    frame = Rectifier(raw).step(
        StereoFrame(tick=0, left=left, right=left, colour=np.repeat(left[..., None], 3, axis=2))
    )
    assert frame.colour is not None
    np.testing.assert_allclose(centre(frame.colour[..., 0]), centre(frame.left), atol=0.01)  # rounded alike


def test_images_of_another_size_are_refused() -> None:
    image = np.zeros((400, 640), np.uint8)
    with pytest.raises(ValueError, match="the left image has 640x400 px, its camera was calibrated with 1344x391 px"):
        Rectifier(rig()).step(StereoFrame(tick=0, left=image, right=image))


def test_cameras_that_look_apart_are_refused() -> None:
    """60 deg between 100 deg cameras leave a strip that both see, far too narrow."""
    with pytest.raises(ValueError, match="too little in common"):
        Rectifier(rig((0.0, 60.0, 0.0)))
