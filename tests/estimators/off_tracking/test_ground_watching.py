"""Ground-watching on drawn ground: two cameras under a trailer, and what ground does to them that keeps not still."""

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.ground_view import Pairs, ground_motion, planar_motion
from estimators.off_tracking.ground_watching import GroundWatching, SingleGroundWatching
from estimators.off_tracking.pose_chain import Sample, closed, extended, first_sample, levelled
from estimators.rigid_motion import UncertainMotion
from sensors.camera.rig import StereoRig, ground_watching_pair
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse, planar, rotation_zyx, transform

FOLLOW = 4.0  # a short trailer, so that drives are short [m]
STEP = 0.25  # between frames [m]
CALIBRATION = ground_watching_pair(320, 320, math.radians(70.0), front_x=-0.5, rear_x=-3.7, z=1.0)
TEXEL = 0.004  # half a pixel of these cameras [m]


def grain(seed: int) -> FloatArray:
    """Ground of 16 m a side, grey levels; blobs of 1 to 5 cm."""
    white = np.random.default_rng(seed).standard_normal((4096, 4096), dtype=np.float32)
    fine = cv2.GaussianBlur(white, (0, 0), 3.0)
    coarse = cv2.resize(cv2.GaussianBlur(fine[::4, ::4], (0, 0), 3.0), (4096, 4096))
    return np.asarray(125.0 + 18.0 * fine / fine.std() + 12.0 * coarse / coarse.std(), dtype=np.float32)


@pytest.fixture(scope="module")
def ground() -> FloatArray:
    return grain(1)


def view(texture: FloatArray, X_WC: FloatArray, rng: np.random.Generator) -> GreyImage:
    """The level ground as a camera at X_WC (4, 4) sees it, with sensor noise of 2 grey levels."""
    c = CALIBRATION
    K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
    to_pixels = K @ X_WC[:3, :3].T @ np.column_stack([np.eye(3)[:, :2], -X_WC[:3, 3]])
    to_texels = np.diag([1.0 / TEXEL, 1.0 / TEXEL, 1.0]) @ np.linalg.inv(to_pixels)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpPerspective(texture, to_texels, (c.width, c.height), flags=flags, borderMode=cv2.BORDER_WRAP)
    noisy = np.rint(image + 2.0 * rng.standard_normal(image.shape))
    return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)


def pose(k: float) -> FloatArray:
    """The trailer after k frames: hitch and follow point on a left circle of 8 m, the rear sliding to and fro."""
    angle = k * STEP / 8.0
    slide = math.radians(1.5) * (1.0 - math.cos(0.2 * k))
    p = np.array([7.0 + 8.0 * math.sin(angle), 3.0 + 8.0 * (1.0 - math.cos(angle)), 0.0])
    return transform(rotation_zyx(angle - math.asin(0.5 * FOLLOW / 8.0) + slide, 0.0, 0.0), p)


def frames(front: FloatArray, rear: FloatArray, poses: Sequence[FloatArray], tilt: float = 0.0) -> list[StereoFrame]:
    """Frames of both cameras at these poses every 0.1 s, the body rolled by ``tilt`` [rad]."""
    rng, seen = np.random.default_rng(2), []
    rolled = transform(rotation_zyx(0.0, 0.0, tilt), np.zeros(3))
    for k, X_WS in enumerate(poses):
        X_WC = X_WS @ rolled @ CALIBRATION.X_SC
        left, right = view(front, X_WC, rng), view(rear, X_WC @ CALIBRATION.X_ClCr, rng)
        seen.append(StereoFrame(tick=100 * k, left=left, right=right))
    return seen


DRIVE = [pose(k) for k in range(30)]


@pytest.fixture(scope="module")
def drive(ground: FloatArray) -> list[StereoFrame]:
    return frames(ground, ground, DRIVE)


def followed(system: GroundWatching, seen: Sequence[StereoFrame]) -> list[OffTracking]:
    """Off-tracking at every frame after the first."""
    memory, found = system.init(), []
    for frame in seen:
        memory, estimate = system.step(memory, frame)
        if estimate is not None:
            found.append(estimate.off_tracking)
    return found


def true_off_tracking(k: int) -> float:
    """Crossing of the hitch's path with the lateral line through the follow point, by bisection [m]."""
    X_SW, low, high = inverse(pose(k)), k - 2.0 * FOLLOW / STEP, float(k)
    for _ in range(60):
        middle = 0.5 * (low + high)
        behind = (X_SW @ pose(middle))[0, 3] < -FOLLOW
        low, high = (middle, high) if behind else (low, middle)
    return float((X_SW @ pose(high))[1, 3])


def errors(found: Sequence[OffTracking]) -> FloatArray:
    """Estimate minus truth where there is an estimate [m]."""
    return np.array([o.value - true_off_tracking(o.tick // 100) for o in found if o.health is not Health.LOST])


@pytest.fixture(scope="module")
def known(drive: list[StereoFrame]) -> list[OffTracking]:
    """Off-tracking of the drive by two cameras, without lost estimates."""
    return [o for o in followed(GroundWatching(CALIBRATION, FOLLOW), drive) if o.health is not Health.LOST]


@pytest.mark.slow
def test_two_cameras_measure_off_tracking_to_millimetres(known: list[OffTracking]) -> None:
    """One match stands between path and follow point: half a pixel is 2 mm, and a hundred features average it."""
    assert len(known) >= 12
    assert all(o.health is Health.OK for o in known)
    assert np.abs(errors(known)).max() < 0.003
    assert np.abs([true_off_tracking(o.tick // 100) for o in known]).max() > 0.05  # there is something to measure


def test_its_uncertainty_is_honest(known: list[OffTracking]) -> None:
    """Stated deviations are neither smaller than the errors nor many times larger."""
    normalised = errors(known) / [o.std for o in known]
    assert 0.05 < math.sqrt(np.mean(normalised**2)) < 1.5
    assert max(o.std for o in known) < 0.01


def test_one_camera_drifts_but_keeps_its_bearings(drive: list[StereoFrame]) -> None:
    """A degree of yaw over 4 m would be 35 mm in the middle of the way."""
    found = followed(SingleGroundWatching(CALIBRATION, FOLLOW), drive)
    assert np.abs(errors(found)).max() < 0.03


def test_a_tilted_camera_does_not_turn_the_path(ground: FloatArray) -> None:
    """Half a degree of roll looks like 0.5 deg of yaw a metre to a rigid fit, some 70 mm over this way."""
    found = followed(SingleGroundWatching(CALIBRATION, FOLLOW), frames(ground, ground, DRIVE, tilt=math.radians(0.5)))
    assert np.abs(errors(found)).max() < 0.03


@pytest.mark.slow
def test_ground_reformed_between_the_cameras_is_not_recognised_and_said_so(ground: FloatArray) -> None:
    """The rear camera sees other ground: both cameras' motion has to do, and the health tells."""
    found = followed(GroundWatching(CALIBRATION, FOLLOW), frames(ground, grain(9), DRIVE))
    known = [o for o in found if o.health is not Health.LOST]
    assert all(o.health is Health.DEGRADED for o in known)
    assert np.abs(errors(found)).max() < 0.03


@pytest.mark.slow
def test_ground_that_flows_along_is_what_the_system_can_not_see_through(ground: FloatArray) -> None:
    """Slurry at a tenth of the velocity under both cameras: the way comes out a tenth short, without contradiction."""
    first = DRIVE[0][:3, 3]
    shifted = [transform(X[:3, :3], first + 0.9 * (X[:3, 3] - first)) for X in DRIVE]
    found = followed(GroundWatching(CALIBRATION, FOLLOW), frames(ground, ground, shifted))
    assert np.abs(errors(found)).max() > 0.05


@pytest.mark.slow
def test_a_standstill_does_not_drift(ground: FloatArray) -> None:
    """Fifteen noisy pictures of the same ground are no motion at all, and the path survives them."""
    poses = [*DRIVE[:20], *[DRIVE[19]] * 15]
    found = followed(GroundWatching(CALIBRATION, FOLLOW), frames(ground, ground, poses))
    assert found[-1].value == pytest.approx(found[18].value, abs=2e-3)  # the noise of two matches with the front view
    assert found[-1].v_x == 0.0  # exactly: noise is not passed on, or it would add up over minutes


@pytest.mark.slow
def test_a_blinded_frame_is_lost_and_passed_over(drive: list[StereoFrame]) -> None:
    """Black pictures show no ground; the next frame is compared with the one before them."""
    black = np.zeros_like(drive[0].left)
    broken = [replace(frame, left=black, right=black) if k == 22 else frame for k, frame in enumerate(drive)]
    found = followed(GroundWatching(CALIBRATION, FOLLOW), broken)
    assert found[21].health is Health.LOST
    assert found[21].value == 0.0
    assert found[-1].health is Health.OK
    assert abs(errors(found[-1:])[0]) < 0.003


def test_with_one_of_two_cameras_blind_it_goes_on_in_doubt(drive: list[StereoFrame]) -> None:
    """Mud on the rear lens: the front camera alone carries the motion."""
    blind = [replace(frame, right=np.zeros_like(frame.right)) for frame in drive]
    known = [o for o in followed(GroundWatching(CALIBRATION, FOLLOW), blind) if o.health is not Health.LOST]
    assert len(known) >= 12
    assert all(o.health is Health.DEGRADED for o in known)


def test_the_motion_in_the_message_is_that_of_the_front_camera(drive: list[StereoFrame]) -> None:
    """A log turns it back into the body's motion with the pose of the left camera."""
    system = GroundWatching(CALIBRATION, FOLLOW)
    memory, _ = system.step(system.init(), drive[0])
    _, estimate = system.step(memory, drive[1])
    assert estimate is not None
    assert estimate.motion is not None
    moved = planar(CALIBRATION.X_SC @ estimate.motion.X_PC @ inverse(CALIBRATION.X_SC))
    truth = planar(inverse(DRIVE[0]) @ DRIVE[1])
    assert (moved.x, moved.y) == pytest.approx((truth.x, truth.y), abs=1e-3)  # noise of half a pixel over 100 features
    assert moved.psi == pytest.approx(truth.psi, abs=2e-4)  # 1 mm across the 3.2 m between the cameras, 0.3 mrad
    shift = np.median(estimate.motion.tracks[:, 2:] - estimate.motion.tracks[:, :2], axis=0)
    forwards = truth.x * CALIBRATION.focal_length / 1.0  # the ground moves to the rear, which is to the right [px]
    assert shift[0] == pytest.approx(forwards, rel=0.05)


def test_cameras_that_look_at_the_horizon_are_refused() -> None:
    """The rear-facing pair on the roof sees no ground below."""
    rig = StereoRig(facing="rear", width=320, height=240, hfov=1.5, x=-4.0, y=0.0, z=3.0, baseline=0.5)
    with pytest.raises(ValueError, match=r"90 deg off the vertical.*look down"):
        GroundWatching(rig.calibration(), FOLLOW)


def scattered(X_PC: FloatArray, middle: float, n: int = 80, noise: float = 0.0, seed: int = 5) -> Pairs:
    """Places a metre around ``middle`` on the trailer's axis, before (in P) and after a motion."""
    rng = np.random.default_rng(seed)
    q = np.array([middle, 0.0]) + rng.uniform(-0.5, 0.5, (n, 2))
    p = q @ X_PC[:2, :2].T + X_PC[:2, 3] + noise * rng.standard_normal((n, 2))
    return Pairs(p, q, n)


MOVED = transform(rotation_zyx(0.7, 0.0, 0.0), np.array([0.3, -0.2, 0.0]))


def test_planar_motion_is_exact_on_exact_places() -> None:
    """Procrustes' problem: the singular vectors of the covariance give the rotation."""
    np.testing.assert_allclose(planar_motion(scattered(MOVED, -2.0)).X, MOVED, atol=1e-12)


def test_covariance_of_a_planar_motion_is_that_of_its_errors() -> None:
    """Over many draws; with the factor of 2 for correlated errors in, the independent ones here come to half."""
    draws = [planar_motion(scattered(MOVED, -2.0, noise=2e-3, seed=seed)) for seed in range(300)]
    off = [(planar(X).psi - 0.7, X[0, 3] - 0.3, X[1, 3] + 0.2) for X, *_ in draws]
    stated = np.sqrt(np.mean([np.diag(motion.covariance)[2:5] for motion in draws], axis=0))
    np.testing.assert_allclose(
        np.std(off, axis=0), 0.5 * stated, rtol=0.15
    )  # 300 draws know a deviation to 4 %, 1 sigma


def test_cameras_that_contradict_each_other_say_so() -> None:
    """The rear one sees ground that lags by 4 cm: the motion is as uncertain as that."""
    forwards = transform(np.eye(3), np.array([0.4, 0.0, 0.0]))
    lagging = transform(np.eye(3), np.array([0.36, 0.0, 0.0]))
    middles = np.array([-1.0, 0.0]), np.array([-4.0, 0.0])
    agreeing = ground_motion([(scattered(forwards, -1.0), middles[0]), (scattered(forwards, -4.0), middles[1])])
    contrary = ground_motion([(scattered(forwards, -1.0), middles[0]), (scattered(lagging, -4.0), middles[1])])
    assert agreeing[1] < 1e-6
    assert contrary[1] > 0.02
    assert math.sqrt(contrary[0].covariance[3, 3]) > 0.02


def chain(poses: Sequence[FloatArray]) -> tuple[Sample, ...]:
    samples: tuple[Sample, ...] = (first_sample(0),)
    for k in range(1, len(poses)):
        increment = UncertainMotion(inverse(poses[k - 1]) @ poses[k], 1e-8 * np.eye(6))
        samples = extended(samples, 100 * k, increment, doubtful=False, keep_start=False)
    return samples


def test_closing_a_path_puts_the_recognised_place_right_and_bends_the_rest() -> None:
    """A steady drift of the yaw is taken out: all of it where the place was recognised, most of it on the way there."""
    poses = [transform(np.eye(3), np.array([0.5 * k, 0.0, 0.0])) for k in range(11)]
    bent = [transform(rotation_zyx(1e-3 * k, 0.0, 0.0), np.array([0.5 * k, 0.0, 0.0])) for k in range(11)]
    drifted = chain(bent)
    X_CK = inverse(poses[10]) @ poses[2]
    put_right = closed(drifted, 8, X_CK)
    np.testing.assert_allclose(levelled(put_right)[1][8], X_CK[:3, 3], atol=1e-12)
    # Shares of one rigid correction do not bend as the drift did: a quarter of its largest offset may be left.
    np.testing.assert_allclose(levelled(put_right)[1][:9, 1], 0.0, atol=0.25 * 0.04)
    assert np.abs(levelled(drifted)[1][:9, 1]).max() > 0.03
    np.testing.assert_allclose(put_right[0].X_OS, drifted[0].X_OS, atol=1e-12)  # the newest stays where it is
