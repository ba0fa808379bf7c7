"""VISO2-S as the paper has it, on synthetic stereo views and piece by piece."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from estimators.estimates import Health
from estimators.odometry.image_points import moved
from estimators.odometry.viso2 import Velocity, Viso2Odometry, expected_motion, started, updated
from estimators.odometry.viso2_matching import (
    BLOB,
    CORNER,
    Features,
    Placed,
    Window,
    blob_response,
    circular_matches,
    corner_response,
    detect_features,
    most_similar,
    pair_features,
)
from estimators.rigid_motion import UncertainMotion
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, so3_exp, transform


def test_features_are_blobs_and_corners_at_whole_pixels() -> None:
    """A bright dot is a blob, a dark one one of another kind; a chessboard's corner is a corner."""
    image = np.full((80, 160), 100, np.uint8)
    image[20:23, 30:33] = 200
    image[20:23, 70:73] = 20
    image[40:60, 100:120] = image[60:79, 120:140] = 200
    features = detect_features(image)
    kinds = {tuple(point): int(kind) for point, kind in zip(features.points.tolist(), features.kind, strict=True)}
    assert kinds[31, 21] == 0
    assert kinds[71, 21] == 1
    assert any(kind in (2, 3) and abs(u - 119.5) <= 1 and abs(v - 59.5) <= 1 for (u, v), kind in kinds.items())


@pytest.mark.parametrize("std", [2.0, 8.0])
def test_noise_has_less_than_one_feature_of_a_kind_in_a_bucket(std: float) -> None:
    """On a plain surface, however strong it is; 27 x 8 buckets of 50 x 50 px."""
    noise = std * np.random.default_rng(0).standard_normal((391, 1344))
    plain = np.clip(np.rint(120.0 + noise), 0, 255).astype(np.uint8)
    of_a_kind = np.bincount(detect_features(plain).kind, minlength=4)
    assert np.all((of_a_kind > 20) & (of_a_kind < 27 * 8))


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_saturated_images_have_no_features(grey: int) -> None:
    assert len(detect_features(np.full((391, 1344), grey, np.uint8)).points) == 0


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.4, 0.7])
def test_features_do_not_depend_on_brightness_and_contrast(drive: Drive, gain: float) -> None:
    image = drive.frames[20].left
    darker = np.rint(gain * image + 10.0).astype(np.uint8)
    points, found = (detect_features(one).points for one in (image, darker))
    assert len(found) == pytest.approx(len(points), rel=0.1)
    assert len(set(map(tuple, found.tolist())) & set(map(tuple, points.tolist()))) > 0.75 * len(points)


def test_texture_everywhere_is_not_taken_for_noise() -> None:
    """No smooth place to measure the noise at, as on gravel that is looked down at: buckets are full all the same."""
    gravel = np.random.default_rng(0).integers(40, 200, (391, 1344)).astype(np.uint8)
    points = detect_features(np.asarray(cv2.GaussianBlur(gravel, (0, 0), 1.5))).points
    assert len(points) > 27 * 8 * 10


def test_resampled_noise_is_noise() -> None:
    """A rectified image's is not white any more and differs from place to place: twice as many features as of white."""
    noise = 2.0 * np.random.default_rng(0).standard_normal((391, 1344))
    plain = np.clip(np.rint(120.0 + noise), 0, 255).astype(np.uint8)
    u, v = np.meshgrid(0.99 * np.arange(1344.0), 0.99 * np.arange(391.0))
    resampled = cv2.remap(plain, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    assert len(detect_features(np.asarray(resampled)).points) < 2 * 4 * 27 * 8  # of four kinds


def test_glare_does_not_hide_the_noise(drive: Drive) -> None:
    image = drive.frames[20].left.copy()
    image[:, :448] = 255
    whole = detect_features(drive.frames[20].left).points
    kept = np.count_nonzero(whole[:, 0] > 460)
    assert np.count_nonzero(detect_features(image).points[:, 0] > 460) == pytest.approx(kept, rel=0.1)


def test_responses_are_those_to_the_masks(drive: Drive) -> None:
    """Sums over squares are a short way to the very same numbers, at the edges as well."""
    image = drive.frames[20].left
    assert np.array_equal(blob_response(image), cv2.filter2D(image, cv2.CV_16S, BLOB))
    assert np.array_equal(corner_response(image), cv2.filter2D(image, cv2.CV_16S, CORNER))


@pytest.mark.parametrize("window", [Window(60.0, 20.0, 12.0), Window(90.3, 0.0, 1.0), Window(0.0, 90.3, 1.0)])
@pytest.mark.usefixtures("back_end")
def test_most_similar_is_what_a_full_search_finds(window: Window) -> None:
    """Against brute force over all pairs: windows to both sides and to one, ends included, empty ones among them."""
    rng = np.random.default_rng(1)
    sought, others = (some_features(rng, count) for count in (300, 400))
    sought.points[:40], sought.kind[:40] = others.points[:40], others.kind[:40]  # no disparity at all
    others.points[-1], others.points[-2] = (-9, 10), (20_000, 30)  # predicted outside of the image
    sought.points[-1], sought.points[-2] = (-5, 10), (19_990, 30)
    sought.kind[-2:], others.kind[-2:] = 0, 0
    placed, candidates = (Placed(f, f.points.astype(np.float64)) for f in (sought, others))
    found = most_similar(placed, candidates, window)
    offset = others.points[None] - sought.points[:, None]
    allowed = (offset[..., 0] >= -window.left) & (offset[..., 0] <= window.right)
    allowed &= np.abs(offset[..., 1]) <= window.rows
    allowed &= others.kind[None] == sought.kind[:, None]
    difference = np.abs(others.descriptors[None].astype(int) - sought.descriptors[:, None]).sum(axis=2)
    cost = np.where(allowed, difference, 10**6)
    assert np.array_equal(found, np.where(allowed.any(axis=1), np.argmin(cost, axis=1), -1))
    assert np.any(found < 0)
    assert np.any(found >= 0)
    assert np.all(most_similar(Placed(sought, placed.position + 5e4), candidates, window) == -1)  # nothing is there


def some_features(rng: np.random.Generator, count: int) -> Features:
    points = np.column_stack([rng.integers(0, 600, count), rng.integers(0, 200, count)])
    descriptors = rng.integers(0, 255, (count, 32)).astype(np.uint8)
    return Features(points, rng.integers(0, 4, count), np.ones(count, np.float32), descriptors)


def test_matches_are_whole_pixels_two_a_bucket_and_right(drive: Drive) -> None:
    """The loop of four images and the neighbours leave few wrong ones: within 2 px of where the point went."""
    previous, current = (pair_features(drive.frames[k]) for k in (20, 21))
    X_PC = drive.camera_motion(20, 21)
    matches = circular_matches(drive.calibration, previous, current, np.eye(4), 60.0)
    assert len(matches.current) > 200
    assert np.all(matches.current[:, 0] % 1.0 == 0.0)
    disparity = matches.current[:, 0] - matches.current[:, 2]
    assert np.all((disparity % 1.0 == 0.0) | (disparity == pytest.approx(0.05)))  # none: very far away
    _, counts = np.unique(matches.current[:, :2] // 50, axis=0, return_counts=True)
    assert counts.max() <= 2
    off = np.abs(moved(drive.calibration, matches.previous, X_PC) - matches.current).max(axis=1)
    assert np.mean(off < 2.0) > 0.9


def test_noise_is_known_from_the_first_motion_on(drive: Drive) -> None:
    """Then a frame that repeats the one before is lost, and what a motion tells is kept."""
    odometry = Viso2Odometry(drive.calibration)
    memory, (motion,) = drive.run(odometry, drive.frames[20:22])
    assert motion.health is Health.OK
    assert memory.noise > 0.5
    after, (repeated,) = drive.run(odometry, [replace(drive.frames[21], tick=2150)], memory)
    assert repeated.health is Health.LOST
    assert after is memory


def measured(velocity: float, std: float) -> UncertainMotion:
    """0.1 s at that velocity along z, turning at a tenth of it about y."""
    X = transform(so3_exp(np.array([0.0, 0.01 * velocity, 0.0])), np.array([0.0, 0.0, 0.1 * velocity]))
    return UncertainMotion(X, np.diag(np.full(6, std**2)))


def filtered(velocities: FloatArray, std: float) -> list[Velocity]:
    states = [started(100, 100, measured(velocities[0], std))]
    for k, velocity in enumerate(velocities[1:], start=2):
        state = updated(states[-1], 100 * k, 100, measured(velocity, std))
        assert state is not None
        states.append(state)
    return states


def test_filter_follows_constant_acceleration_without_lag() -> None:
    """Its model: after the start velocity and acceleration are those of the ramp."""
    states = filtered(np.linspace(5.0, 5.0 + 0.15 * 39, 40), 1e-3)  # 1.5 m/s2
    assert states[-1].state[5, 0] == pytest.approx(5.0 + 0.15 * 39, abs=1e-3)
    assert states[-1].state[5, 1] == pytest.approx(1.5, abs=0.02)
    ahead = expected_motion(states[-1], 4100, 100)
    assert ahead[2, 3] == pytest.approx(0.1 * (5.0 + 0.15 * 40), abs=1e-3)


def test_filter_knows_the_velocity_of_a_first_motion_and_no_acceleration() -> None:
    """0.1 s with a standard deviation of 10 mm; afterwards the speed may change by 3 m/s2, the yaw rate by 1 rad/s2."""
    (state,) = filtered(np.array([5.0]), 0.01)
    np.testing.assert_allclose(state.state[[1, 5]], [[0.5, 0.0], [5.0, 0.0]], atol=1e-9)
    for component, acceleration in ((1, 1.0), (5, 3.0)):
        np.testing.assert_allclose(state.covariance[component], np.diag([0.1**2, acceleration**2]))


def test_filter_smooths_the_noise_and_keeps_the_sum() -> None:
    """10 mm of noise a motion at constant speed: smoother, while the way travelled is the measured one."""
    noise = np.asarray(0.1 * np.random.default_rng(3).standard_normal(200), dtype=np.float64)  # [m/s]
    states = filtered(5.0 + noise, 0.01)
    out = np.array([state.state[5, 0] for state in states]) - 5.0
    assert np.std(out[20:]) < 0.8 * np.std(noise[20:])
    assert 0.1 * abs(out[20:].sum() - noise[20:].sum()) < 0.03  # [m] of 90 m: the ends


def test_filter_starts_anew_after_a_contradiction() -> None:
    """A wrong motion is 100 deviations off: the right ones after it must not make up for it."""
    state = filtered(np.full(20, 5.0), 1e-3)[-1]
    assert updated(state, 2100, 100, measured(4.0, 1e-3)) is None
    assert updated(state, 2100, 100, measured(5.02, 1e-3)) is not None
