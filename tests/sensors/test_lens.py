"""Cameras: the lens against OpenCV's, the file of a raw rig, which way rigs look, noise and frames."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given, reject, settings
from hypothesis import strategies as st

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import (
    UNDISTORTED,
    CameraModel,
    Facing,
    RawStereoRig,
    StereoCalibration,
    StereoRig,
    load_raw_rig,
    mount_rotation,
)
from sensors.camera.stereo_camera import StereoCamera
from sensors.messages import ColourImage
from tests.trailers import truth
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, transform

BARREL = (-0.2, 0.04, 0.001, -0.0008, -0.003)
PINCUSHION = (0.1, 0.02, -0.001, 0.002, 0.001)
RATIONAL = (0.6, 0.05, 0.0005, -0.0003, 0.001, 0.95, 0.2, 0.005)
FISHEYE = (-0.01, 0.03, -0.02, 0.004)


def camera(distortion: tuple[float, ...]) -> CameraModel:
    return CameraModel(
        width=1344,
        height=391,
        fx=563.0,
        fy=560.0,
        cx=668.0,
        cy=197.0,
        distortion=distortion,
        fisheye=len(distortion) == 4,
    )


def pose(R: FloatArray, x: float, y: float = 0.0, z: float = 0.0) -> FloatArray:
    return transform(R, np.array([x, y, z]))


def rig(X_ClCr: FloatArray) -> RawStereoRig:
    return RawStereoRig(left=camera(BARREL), right=camera(PINCUSHION), X_ClCr=X_ClCr, X_SC=pose(np.eye(3), -13.6))


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, RATIONAL, FISHEYE])
def test_projection_is_opencvs(distortion: tuple[float, ...]) -> None:
    """The same coefficients in the same order mean the same lens; agreement up to rounding."""
    points = np.random.default_rng(0).uniform([-1.2, -0.35, 1.0], [1.2, 0.35, 1.0], (500, 3)) * [[7.0]]
    points[0] = [0.0, 0.0, 7.0]
    model = camera(distortion)
    if model.fisheye:
        pixels = cv2.fisheye.projectPoints(
            points[:, None], np.zeros(3), np.zeros(3), model.matrix, np.array(distortion)
        )
    else:
        pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), model.matrix, np.array(distortion))
    np.testing.assert_allclose(model.project(points), pixels[0].reshape(-1, 2), atol=1e-9)


def test_a_fisheye_that_sees_more_than_the_model_s_rays_is_cut_there() -> None:
    """Lens of 190 deg: its rays are right up to 76 deg off the axis, and no longer than that beyond."""
    wide = CameraModel(width=800, height=800, fx=240.0, fy=240.0, cx=399.5, cy=399.5, distortion=FISHEYE, fisheye=True)
    rays = wide.rays(np.stack(np.meshgrid(np.arange(0.0, 800.0, 7.0), np.arange(0.0, 800.0, 7.0)), axis=-1))
    assert np.hypot(rays[..., 0], rays[..., 1]).max() == pytest.approx(4.0, abs=1e-9)
    inside = np.array([[399.5 + 290.0, 399.5], [399.5, 120.0], [200.0, 200.0]])
    np.testing.assert_allclose(wide.pixels(wide.rays(inside)), inside, atol=1e-9)


@pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, RATIONAL, FISHEYE, (0.0,) * 4, (0.0,) * 5])
def test_rays_invert_pixels_in_all_of_the_image(distortion: tuple[float, ...]) -> None:
    """Corners are the hardest; Newton's method ends within rounding of 1000 px."""
    v, u = np.mgrid[0:391:10, 0:1344:9].astype(float)
    pixels = np.stack([u, v], axis=-1)
    model = camera(distortion)
    np.testing.assert_allclose(model.pixels(model.rays(pixels)), pixels, atol=1e-9)


@settings(max_examples=100)
@example(0.15922870735401773, -0.1998718889087493, 0.03743810734933192)  # Newton's first steps leave these lenses
@example(-0.35859035889223334, -0.03895128361408601, 0.04777973030640692)
@example(-0.5622950595760463, 0.08940703984879111, 0.0360941664563547)
@given(st.floats(-0.6, 0.3), st.floats(-0.2, 0.2), st.floats(-0.05, 0.05))
def test_every_lens_that_is_accepted_can_be_inverted(k1: float, k2: float, k3: float) -> None:
    try:
        model = camera((k1, k2, 0.0, 0.0, k3))
    except ValueError:
        reject()
    corners = np.array([[0.0, 0.0], [1343.0, 0.0], [0.0, 390.0], [1343.0, 390.0]])
    # [px] A lens that all but folds over at its corner magnifies rounding there, and is tried in steps of 0.002.
    np.testing.assert_allclose(model.pixels(model.rays(corners)), corners, atol=1e-3)


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        (lambda good: replace(good, fx=0.0), "fx = 0.0 px must be positive"),
        (lambda good: replace(good, width=0), "image of 0x391 px"),
        (lambda good: replace(good, distortion=(-0.4, 0.0, 0.0, 0.0, 0.0)), "folds over"),
        (lambda good: replace(good, distortion=(math.nan, 0.0, 0.0, 0.0, 0.0)), "five numbers"),
        (lambda good: replace(good, fisheye=True), "four numbers k1 to k4"),
        (lambda good: replace(good, fisheye=True, distortion=(-0.4, 0.0, 0.0, 0.0)), "folds over"),
    ],
)
def test_cameras_that_can_not_be_are_refused(wrong: Callable[[CameraModel], CameraModel], complaint: str) -> None:
    good = CameraModel(width=1344, height=391, fx=563.0, fy=560.0, cx=668.0, cy=197.0)
    with pytest.raises(ValueError, match=complaint):
        wrong(good)


def test_mount_rotation_is_the_papers() -> None:
    """Eq. (9) of de Saxe & Cebon 2018, each factor from OpenCV's rotation vectors; yaw turns the view to the right."""
    roll, yaw, pitch = 0.1, -0.2, 0.3
    factors = [cv2.Rodrigues(np.array(w))[0] for w in ((0.0, 0.0, roll), (0.0, yaw, 0.0), (pitch, 0.0, 0.0))]
    np.testing.assert_allclose(mount_rotation(roll, yaw, pitch), factors[0] @ factors[1] @ factors[2], atol=1e-15)
    assert (mount_rotation(0.0, 0.1, 0.0) @ [0.0, 0.0, 1.0])[0] > 0.0


@pytest.mark.parametrize("distortion", [BARREL, RATIONAL, FISHEYE])
def test_a_rig_comes_back_from_its_file_to_the_last_bit(tmp_path: Path, distortion: tuple[float, ...]) -> None:
    written = rig(pose(mount_rotation(-0.0026, 0.0017, 1e-5), 0.5003, 1.0 / 3.0 * 1e-3))
    written = replace(written, left=camera(distortion))
    file = tmp_path / "rig.toml"
    file.write_text(written.to_toml(), encoding="utf-8")
    read = load_raw_rig(file)
    assert (read.left, read.right) == (written.left, written.right)
    assert np.array_equal(read.X_ClCr, written.X_ClCr)
    assert np.array_equal(read.X_SC, written.X_SC)
    assert read.baseline == pytest.approx(0.5003, abs=1e-6)


@pytest.mark.parametrize(
    ("was", "instead", "complaint"),
    [
        ("fx = 563.0\n", "", r"rig.toml: keys are missing: 'left.fx' \[px\], 'right.fx' \[px\]"),
        ("distortion = [-0.2, ", "distortion = [", r"rig.toml: distortion = .* must be five numbers"),
        ("[left]", "[lift]", "rig.toml: key 'left' is missing"),
    ],
)
def test_a_broken_rig_file_is_one_clear_line(tmp_path: Path, was: str, instead: str, complaint: str) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(rig(pose(np.eye(3), 0.5)).to_toml().replace(was, instead), encoding="utf-8")
    with pytest.raises(ValueError, match=complaint) as refused:
        load_raw_rig(file)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("X_ClCr", "complaint"),
    [
        (pose(np.eye(3), -0.5), "are left and right swapped"),
        (pose(1.01 * np.eye(3), 0.5), "no rigid pose"),
        (pose(np.diag([1.0, 1.0, -1.0]), 0.5), "no rigid pose"),
        (np.eye(3), "four rows"),
    ],
)
def test_poses_that_can_not_be_are_refused(X_ClCr: FloatArray, complaint: str) -> None:
    """Swapped cameras would give negative depths, far from where the mistake was made."""
    with pytest.raises(ValueError, match=complaint):
        rig(X_ClCr)


# Which way the rigs look


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


# Noise, grey images, and what a frame shows


SHAPE = (391, 1344)
MID_GREY = np.full(SHAPE, 128, dtype=np.uint8)
PIXELS = MID_GREY.size


@pytest.mark.parametrize("std", [1.0, 2.0, 6.0])
def test_noise_has_the_asked_spread_and_no_mean(std: float) -> None:
    """Rounding to whole grey levels adds its variance of 1/12, as in any camera."""
    rng = np.random.default_rng(3)
    noise = NoiseBank.draw(rng, std, PIXELS).added_to(MID_GREY, rng).astype(float) - 128.0
    expected = math.hypot(std, math.sqrt(1.0 / 12.0))
    assert abs(noise.mean()) < 5.0 * expected / math.sqrt(PIXELS)  # five standard errors of the mean
    assert noise.std() == pytest.approx(expected, rel=0.01)  # ten standard errors


def test_noise_of_any_two_images_is_uncorrelated() -> None:
    """Left and right, and one frame and the next, each get noise of their own; so does each pixel."""
    rng = np.random.default_rng(4)
    bank = NoiseBank.draw(rng, 4.0, PIXELS)
    images = [bank.added_to(MID_GREY, rng).astype(float) - 128.0 for _ in range(6)]
    between = np.corrcoef([image.ravel() for image in images]) - np.eye(6)
    limit = 5.0 / math.sqrt(PIXELS)  # five standard errors of a correlation of independent pixels
    assert np.abs(between).max() < limit
    for neighbour in (images[0][:, 1:] * images[0][:, :-1], images[0][1:] * images[0][:-1]):
        assert abs(neighbour.mean()) / images[0].var() < limit


def test_noise_saturates_instead_of_wrapping() -> None:
    rng, fresh = np.random.default_rng(5), np.random.default_rng
    bank = NoiseBank.draw(rng, 5.0, PIXELS)
    assert bank.added_to(np.full((*SHAPE, 4), 255, dtype=np.uint8), rng).min() > 200  # 255 - 11 deviations
    assert bank.added_to(np.zeros((*SHAPE, 4), dtype=np.uint8), rng).max() < 55
    image = rng.integers(0, 256, (*SHAPE, 4), dtype=np.uint8)  # of which one compiled pass makes the same as OpenCV
    assert (bank.added_to(image, fresh(1)) == bank.added_to(grey(image), fresh(1))).all()


def test_green_is_the_brightest_primary() -> None:
    """Luminance weighs red, green and blue with 0.299, 0.587, 0.114: the order of the channels is pinned."""
    primaries = (255 * np.eye(3, dtype=np.uint8)).reshape(1, 3, 3)
    np.testing.assert_allclose(grey(primaries)[0], [76, 150, 29], atol=1)  # one level of rounding


class _Painted:
    """A renderer whose images tell the x of the pose they were asked for."""

    def __init__(self, calibration: StereoCalibration) -> None:
        self.calibration = calibration

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        left = np.full((*SHAPE, 3), int(X_WB[0, 3]), dtype=np.uint8)
        return left, left + np.uint8(1)


def _truth(tick: int) -> Truth:
    """Two units whose bodies are at x = 10 m and x = 20 m."""
    bodies = np.tile(np.eye(4), (2, 1, 1))
    bodies[:, 0, 3] = 10.0, 20.0
    return truth(tick, bodies=bodies)


@pytest.mark.parametrize("keep_colour", [False, True])
def test_frame_is_what_the_cameras_on_the_unit_saw(calibration: StereoCalibration, keep_colour: bool) -> None:
    """Stamped with the capture tick; left and right not swapped; colour only when asked for."""
    camera = StereoCamera(
        renderer=_Painted(calibration), unit=1, noise_std=0.0, rng=np.random.default_rng(0), keep_colour=keep_colour
    )
    frame = camera.sample(_truth(70))
    assert frame.tick == 70
    assert (frame.left == 20).all()
    assert (frame.right == 21).all()
    assert (frame.colour is not None) == keep_colour
    assert camera.calibration is calibration
