"""Matching of exposures, within a pair and over time."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.context import Odometry
from estimators.estimates import Health
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.exposure import cell_means, clipped_share, match_clipping, match_exposures, match_over_time
from estimators.odometry.image_points import detect_corners
from estimators.odometry.warped_matching import match_patches
from estimators.stereo_pair import MatchedFrame, Turned, with_levels
from scenarios.catalogue import ODOMETRY, resolve
from sensors.messages import GreyImage, StereoFrame
from tests.estimators.stereo_scene import Drive

CHANGES = [(0.6, 0.0), (0.8, 15.0), (1.0, -30.0), (2.0, 0.0), (0.5, 30.0)]


def exposed(image: GreyImage, gain: float, offset: float) -> GreyImage:
    return np.asarray(np.clip(np.rint(gain * image.astype(np.float64) + offset), 0, 255), dtype=np.uint8)


def right_exposed(frame: StereoFrame, gain: float, offset: float) -> StereoFrame:
    return replace(frame, right=exposed(frame.right, gain, offset))


def level_map(before: GreyImage, between: GreyImage, after: GreyImage) -> tuple[float, float]:
    """Gain and offset from one version of an image to the last one, where none is clipped."""
    inside = np.logical_and.reduce([(image > 5) & (image < 250) for image in (before, between, after)])
    gain, offset = np.polyfit(before[inside].astype(float), after[inside].astype(float), 1)
    return float(gain), float(offset)


def is_untouched(drive: Drive, frame: StereoFrame) -> bool:
    matched = match_exposures(drive.calibration, frame)
    return matched.left is frame.left and matched.right is frame.right


def test_equal_exposures_stay_as_they_are(drive: Drive) -> None:
    assert all(is_untouched(drive, frame) for frame in drive.frames[::5])
    one, other = drive.frames[20:22]
    assert match_over_time(one, other)[0] is one


@pytest.mark.parametrize(("gain", "offset"), CHANGES)
def test_right_image_is_exposed_like_the_left_one(drive: Drive, gain: float, offset: float) -> None:
    """The map from the good right image to the corrected one is the identity: to 2 % and 2 grey levels of rounding."""
    frame = drive.frames[20]
    wrong = right_exposed(frame, gain, offset)
    corrected = match_exposures(drive.calibration, wrong)
    own_gain, own_offset = level_map(frame.right, wrong.right, corrected.right)
    assert own_gain == pytest.approx(1.0, abs=0.02)
    assert own_offset == pytest.approx(0.0, abs=2.5)
    assert match_exposures(drive.calibration, corrected) is corrected
    again = StereoFrame(tick=frame.tick, left=corrected.left, right=corrected.right)
    assert is_untouched(drive, again)  # also if it is not known to be matched


def test_dirt_on_one_lens_is_no_change_of_exposure(drive: Drive) -> None:
    right = drive.frames[20].right.copy()
    right[:, 300:750] = 20
    dirty = replace(drive.frames[20], right=right)
    assert is_untouched(drive, dirty)


def test_blank_images_are_left_alone(drive: Drive) -> None:
    frame = drive.frames[0]
    for blank in (drive.dark(frame), replace(frame, right=np.full_like(frame.right, 255))):
        assert is_untouched(drive, blank)
    tiny = StereoFrame(tick=0, left=frame.left[:20, :40], right=frame.right[:20, :40])
    assert is_untouched(drive, tiny)


def test_exposures_over_time_are_compared_at_the_tracked_points(drive: Drive) -> None:
    """The other frame is exposed alike; at the tracks the map is right to 3 %, whatever moved through the cells."""
    before, now = drive.frames[20:22]
    _, (motion,) = drive.run(CircularOdometry(drive.calibration), [before, now])
    darker = replace(now, left=exposed(now.left, 0.5, 10.0), right=exposed(now.right, 0.5, 10.0))
    changed, _ = match_over_time(before, darker, motion.tracks)
    gain, offset = level_map(before.left, before.left, changed.left)
    assert gain == pytest.approx(0.5, rel=0.03)
    assert 120.0 * gain + offset == pytest.approx(70.0, abs=1.0)  # at the mean level, to a grey level
    assert match_over_time(before, now, motion.tracks)[0] is before


def test_limited_pixels_count_as_clipped(drive: Drive) -> None:
    """The right camera is brighter: the left image is limited to its levels, below 255. The gain over time is right."""
    before, now = (right_exposed(frame, 1.05, 0.0) for frame in drive.frames[20:22])
    _, (motion,) = drive.run(CircularOdometry(drive.calibration), [before, now])
    bright = replace(now, left=exposed(now.left, 1.5, 0.0), right=exposed(now.right, 1.5, 0.0))
    one, other = match_exposures(drive.calibration, before), match_exposures(drive.calibration, bright)
    assert other.left.max() < 250
    changed, _ = match_over_time(one, other, motion.tracks)
    gain, offset = level_map(one.left, one.left, changed.left)
    assert gain == pytest.approx(1.5, rel=0.03)
    assert 120.0 * gain + offset == pytest.approx(180.0, abs=3.0)


def test_clipped_share_counts_what_the_other_camera_does_not_show(drive: Drive) -> None:
    """The left image is limited to the levels of the right one: pixels beyond them are as good as clipped."""
    frame = drive.frames[20]
    bright = float(np.mean(frame.left >= 128))
    limited = match_exposures(drive.calibration, right_exposed(frame, 2.0, 0.0))
    assert clipped_share(frame.left) < 0.02
    assert clipped_share(limited.left) == pytest.approx(bright, abs=0.06)  # a level of noise at the limit is 3 %


def test_cells_are_the_same_without_a_compiler(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of grey levels are whole numbers, so that compiled C and OpenCV agree bit by bit; also of part of an image.

    Cells are compared with means by definition; 1e-12 is rounding.
    """
    image = exposed(drive.frames[20].left, 2.0, -40.0)
    images = (image, np.asfortranarray(image), image[:, 100:-100], image[:20, :70])
    compiled = [(cell_means(one), clipped_share(one)) for one in images]
    assert np.isnan(compiled[0][0]).any()
    means = cell_means(image, clipped=False)
    assert means[2, 3] == np.rint(image[48:72:2, 72:96].mean())
    ends = (image[::4] == image[::4].min()) | (image[::4] == image[::4].max())
    assert compiled[0][1] == pytest.approx(ends.mean(), rel=1e-12)
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    for one, (cells, share) in zip(images, compiled, strict=True):
        np.testing.assert_array_equal(cell_means(one), cells)
        assert clipped_share(one) == share


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
    matched = MatchedFrame(tick=0, left=frame.left, right=turned.resampled(), turned=turned)
    limited = with_levels(matched, levels)
    clipped = Turned(np.minimum(frame.right, 127).astype(np.uint8), half_a_pixel).resampled()
    assert np.array_equal(limited.right, clipped)
    assert np.array_equal(limited.left, np.minimum(frame.left, 127))
    assert not np.array_equal(limited.right, np.minimum(matched.right, 127))  # interpolated first: other edges


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ODOMETRY))
def test_odometry_does_not_mind_the_exposure_of_the_right_camera(drive: Drive, name: str) -> None:
    """Every odometry of the catalogue: as good as with equal exposures, to 1.3 times the error and a floor."""
    odometry: Odometry[Any] = resolve("odometry", name, ODOMETRY)(drive.calibration)
    errors = []
    for frames in (drive.frames[5:11], [right_exposed(frame, 0.6, 15.0) for frame in drive.frames[5:11]]):
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
