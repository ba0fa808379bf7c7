"""Exposures that differ, within a pair and over time, and clipped images."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.context import Odometry
from estimators.estimates import Health
from estimators.odometry.exposure import clipped_share, match_clipping
from estimators.odometry.image_points import detect_corners
from estimators.odometry.warped_matching import match_patches
from estimators.stereo_pair import CorrectedFrame, Turned, with_levels
from scenarios.catalogue import ODOMETRY, resolve
from sensors.messages import GreyImage, StereoFrame
from tests.estimators.stereo_scene import Drive


def exposed(image: GreyImage, gain: float, offset: float) -> GreyImage:
    return np.asarray(np.clip(np.rint(gain * image.astype(np.float64) + offset), 0, 255), dtype=np.uint8)


def right_exposed(frame: StereoFrame, gain: float, offset: float) -> StereoFrame:
    return replace(frame, right=exposed(frame.right, gain, offset))


def test_clipped_share_counts_both_ends_of_the_range(drive: Drive) -> None:
    """Those of the image itself: a camera may end below 255. A level of noise at the limit is 3 %."""
    image = drive.frames[20].left
    assert clipped_share(image) < 0.02
    for clipped in (exposed(image, 2.0, 0.0), np.minimum(image, 127), exposed(image, 1.0, -90.0)):
        ends = np.mean((clipped == clipped.min()) | (clipped == clipped.max()))
        assert clipped_share(clipped) == pytest.approx(ends, abs=0.06)
        assert clipped_share(clipped) > 0.025


def test_patches_of_a_clipped_image_lie_where_they_were(drive: Drive) -> None:
    """The same picture twice as bright: no patch has moved, but without limits half of them are off by 0.03 px or more.

    Clipped alike nine in ten are within 0.03 px: what is left is the error of the gain, and rounding to grey levels.
    """
    frame = drive.frames[20]
    bright = replace(frame, left=exposed(frame.left, 2.0, 0.0), right=exposed(frame.right, 2.0, 0.0))
    image, corners = frame.left, detect_corners(frame.left, per_bucket=4)
    limited = match_clipping(image, bright, np.hstack([corners, corners]))
    assert limited is not None
    off = []
    for source, target in ((image, bright), limited):
        straight = np.tile(np.eye(2), (len(corners), 1, 1))
        matched = match_patches([(source, len(corners))], corners, straight, target.left, corners)
        seen = matched.correlation > 0.75
        assert np.mean(seen) > 0.6
        off.append(np.linalg.norm(matched.points - corners, axis=1)[seen])
    assert np.median(off[0]) > 0.03
    assert np.median(off[1]) < 0.01
    assert np.quantile(off[1], 0.9) < 0.03
    assert match_clipping(image, frame, np.hstack([corners, corners])) is None
    assert match_clipping(image, bright, np.empty((0, 4), np.float32)) is None  # nothing was found: after a black image


def test_levels_change_before_an_image_is_resampled(drive: Drive) -> None:
    """The right image is limited as the camera took it, and turned then: as if the camera had clipped it."""
    frame, levels = drive.frames[20], np.minimum(np.arange(256.0), 127.0)
    half_a_pixel = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    turned = Turned(frame.right, half_a_pixel)
    matched = CorrectedFrame(tick=0, left=frame.left, right=turned.resampled(), turned=turned, right_shift=None)
    limited = with_levels(matched, levels)
    clipped = Turned(np.minimum(frame.right, 127).astype(np.uint8), half_a_pixel).resampled()
    assert np.array_equal(limited.right, clipped)
    assert np.array_equal(limited.left, np.minimum(frame.left, 127))
    assert not np.array_equal(limited.right, np.minimum(matched.right, 127))  # interpolated first: other edges


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ODOMETRY))
@pytest.mark.parametrize(("gain", "offset"), [(0.6, 0.0), (0.8, 15.0), (1.0, -30.0), (2.0, 0.0), (0.5, 30.0)])
def test_odometry_does_not_mind_the_exposure_of_the_right_camera(
    drive: Drive, name: str, gain: float, offset: float
) -> None:
    """Every odometry of the catalogue: as good as with equal exposures, to 1.3 times the error and a floor."""
    odometry: Odometry[Any] = resolve("odometry", name, ODOMETRY)(drive.calibration)
    errors = []
    for frames in (drive.frames[5:11], [right_exposed(frame, gain, offset) for frame in drive.frames[5:11]]):
        motions = drive.run(odometry, frames)[1]
        assert all(motion.health is not Health.LOST for motion in motions)
        errors.append(float(np.sqrt(np.mean(drive.errors(motions)[:, 3:] ** 2))))
    assert errors[1] < 1.3 * errors[0] + 3e-4  # [m] scatter of five motions


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ODOMETRY))
def test_odometry_does_not_mind_a_jump_of_the_exposure(drive: Drive, name: str) -> None:
    """Both cameras 30 grey levels up and twice as bright from one frame to the next."""
    odometry: Odometry[Any] = resolve("odometry", name, ODOMETRY)(drive.calibration)
    changes = [(1.0, 0.0), (1.0, 0.0), (1.0, 30.0), (0.5, 0.0), (1.0, 0.0)]
    frames = [
        replace(frame, left=exposed(frame.left, *change), right=exposed(frame.right, *change))
        for frame, change in zip(drive.frames[5:10], changes, strict=True)
    ]
    errors, clean = (drive.errors(drive.run(odometry, used)[1]) for used in (frames, drive.frames[5:10]))
    assert len(errors) == 4
    assert np.abs(errors[:, 3:]).max() < 1.3 * np.abs(clean[:, 3:]).max() + 2e-3  # [m] half the contrast in one frame
