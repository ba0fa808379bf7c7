"""The buffer of a trailer that goes back: the path it takes up, how long this lasts, and what follows forwards."""

import math
from itertools import pairwise

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BufferMemory, OffTrackingBuffer
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.results.metrics import true_off_tracking
from sensors.messages import BodyPose
from tests.estimators.body_drive import anchored_motions, body, followed, motion, winding
from tests.estimators.off_tracking.test_buffer import another_attempt
from vehicle.frames import FloatArray, Pose2, inverse

LENGTH = 10.0  # hitch to follow point [m]
STEP = 0.1  # from frame to frame [m]


def run(
    poses: list[Pose2], reversing_distance: float = 20.0, covariance: FloatArray | None = None
) -> tuple[BufferMemory, list[OffTracking]]:
    """Off-tracking at every pose but the first, from exact motions of the given covariance."""
    steps = enumerate(pairwise(map(body, poses)))
    motions = [motion(k, k + 1, inverse(a) @ b, covariance=covariance) for k, (a, b) in steps]
    return followed(OffTrackingBuffer(LENGTH, reversing_distance=reversing_distance), motions)


@pytest.mark.slow
def test_going_back_over_its_way_a_trailer_has_the_off_tracking_it_had_there() -> None:
    """Back along the way it came, every pose and so the path behind it are those of before."""
    way = [winding(STEP * k) for k in range(400)]
    _, results = run([*way, *reversed(way[:-1])])
    assert np.ptp([result.value for result in results[250:399]]) > 1.0  # [m] the case is a turning one
    for k in range(220, 398):
        there, back = results[k - 1], results[2 * 399 - k - 1]
        assert back.health is Health.OK
        assert back.value == pytest.approx(there.value, abs=1e-9)  # [m] rounding
        assert back.path_tangent == pytest.approx(there.path_tangent, abs=1e-9)
        assert (back.v_x, back.yaw_rate) == pytest.approx((-results[k].v_x, -results[k].yaw_rate), abs=1e-9)


@pytest.mark.slow
def test_path_is_kept_for_the_reversing_distance_and_no_longer() -> None:
    """20 m back there is still a path beside the follow point, 2 m later there is not; forwards it fills again."""
    way = [Pose2(STEP * k, 0.0, -0.1) for k in range(500)]
    back = [Pose2(way[-1].x - STEP * k, 0.0, -0.1) for k in range(1, 231)]
    again = [Pose2(back[-1].x + STEP * k, 0.0, -0.1) for k in range(1, 120)]
    memory, results = run([*way, *back, *again])
    health = [result.health for result in results]
    first_lost = health.index(Health.LOST, len(way))
    assert 20.0 < STEP * (first_lost - len(way) + 1) < 22.0
    assert len(memory.samples) < (1.2 * LENGTH + 22.0) / STEP
    assert health[-1] is Health.OK
    assert results[-1].value == pytest.approx(-LENGTH * math.tan(0.1), abs=1e-9)  # [m] rounding
    shorter = [result.health for result in run([*way, *back], reversing_distance=5.0)[1]]
    assert 5.0 < STEP * (shorter.index(Health.LOST, len(way)) - len(way) + 1) < 7.0


@pytest.mark.slow
def test_buffer_and_truth_mean_the_same_path() -> None:
    """Back beside the way: the estimator at 10 Hz and the metric at 100 Hz, written apart, agree."""
    poses = another_attempt()
    x, y, psi = np.array(poses).T
    truth = true_off_tracking(x, y, psi, LENGTH)
    reference = ReferenceOffTracking(LENGTH)
    memory, values = reference.init(), np.full(len(poses), np.nan)
    for k in range(0, len(poses), 10):
        memory, result = reference.step(memory, BodyPose(tick=10 * k, X_WB=body(poses[k])))
        if result is not None and result.health is Health.OK:
            values[k] = result.value
    assert np.isfinite(values[2000::10]).all()
    assert np.ptp(values[3000:3900:10]) > 0.3  # [m] the way back is a way beside
    off = np.abs(values - truth)[2000::10]
    assert np.mean(off < 1e-3) > 0.97
    assert off.max() < 0.6  # where the path is joined, 0.6 m apart, one of them is a frame further


def test_reversing_beyond_the_whole_path_begins_a_new_one() -> None:
    """Pushed back past where it started the trailer has no path, and holds no more than a sample or two."""
    poses = [Pose2(STEP * k, 0.0, 0.0) for k in range(50)] + [Pose2(4.9 - STEP * k, 0.0, 0.0) for k in range(1, 200)]
    memory, results = run(poses)
    assert results[-1].health is Health.LOST
    assert len(memory.samples) <= 3


@pytest.mark.slow
def test_folding_up_is_lost_rather_than_wrong() -> None:
    """A trailer pushed until it stands across its path: the off-tracking grows as it turns, then there is none."""
    poses = [Pose2(STEP * k, 0.0, 0.0) for k in range(450)]
    for _ in range(160):
        poses.append(Pose2(poses[-1].x - 0.02, 0.0, poses[-1].psi + math.radians(0.6)))
    _, results = run(poses, covariance=1e-6 * np.eye(6))
    for pose, result in list(zip(poses[1:], results, strict=True))[450:]:
        if result.health is Health.LOST:
            assert pose.psi > math.radians(60.0)
        else:
            assert result.value == pytest.approx(LENGTH * math.tan(pose.psi), rel=1e-3)
            assert 1e-3 < result.std < 10.0
    assert results[-1].health is Health.LOST
    stds = [result.std for result in results[450:] if result.health is not Health.LOST]
    assert stds[-1] > 3.0 * stds[0]  # a line across the path is met farther off and at a shallower angle


@pytest.mark.slow
def test_uncertainty_of_going_back_adds_to_that_of_the_path() -> None:
    """Monte Carlo over the errors of all motions, forwards, 4 m back and 1 m forwards, frame to frame and anchored."""
    x = np.concatenate([np.arange(0.0, 20.0, 0.5), np.arange(19.0, 15.0, -0.5), np.arange(16.0, 17.5, 0.5)])
    poses = [body(winding(t)) for t in x]
    L = 1e-3 * np.tril(np.random.default_rng(5).standard_normal((6, 6)))
    for anchored in (False, True):
        rng, errors = np.random.default_rng(7), []
        for _ in range(60):
            result = noisy_drive(poses, rng, L, anchored=anchored)
            errors.append(result.value)
        spread = float(np.std(errors))
        assert spread > 2e-3  # [m] the errors do something
        # 3 sigma of the spread of 60 is a quarter; out and back errors that belong together are taken for independent
        assert 0.7 < result.std / spread < 1.5


def noisy_drive(poses: list[FloatArray], rng: np.random.Generator, L: FloatArray, *, anchored: bool) -> OffTracking:
    """The last off-tracking of a drive whose motions err by L n each, against the frame before or a keyframe."""
    key = 0

    def keyframe_of(k: int) -> int:
        nonlocal key
        if not anchored or np.linalg.norm(inverse(poses[key])[:3, :3] @ (poses[k - 1] - poses[key])[:3, 3]) > 1.8:
            key = k - 1
        return key

    motions = anchored_motions(poses, keyframe_of, lambda: L @ rng.standard_normal(6), L @ L.T, anchored=anchored)
    return followed(OffTrackingBuffer(LENGTH), motions)[1][-1]
