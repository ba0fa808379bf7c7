"""Calibration: known cameras are found again from photographs of a board, and poor sets are refused with the reason."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from estimators.calibration.boards import BoardView, board_view, calibrated, calibrated_pair, in_same_order
from estimators.rigid_motion import rotation_vector
from sensors.camera.calibration_target import Checkerboard, board_image, random_board_pose
from sensors.camera.rig import CameraModel
from vehicle.frames import FloatArray, inverse, so3_exp, transform

WIDTH, HEIGHT = 1280, 720
BOARD = Checkerboard(columns=9, rows=6, square=0.08)
BARREL = (-0.11, 0.015, 0.0006, -0.0004, -0.0008)
LEFT = CameraModel(width=WIDTH, height=HEIGHT, fx=565.0, fy=563.0, cx=636.0, cy=362.0, distortion=BARREL)
RIGHT = replace(LEFT, fx=563.0, fy=562.0, cx=643.0, cy=357.0, distortion=(-0.10, 0.014, -0.0003, 0.0005, -0.0008))
X_CLCR = transform(so3_exp(np.radians([0.4, -0.6, 0.3])), np.array([0.5, 0.003, -0.002]))
NOISE = 0.035  # of a corner, as measured on rendered boards with 2 grey levels of noise, each coordinate [px]


def seen(camera: CameraModel, X_CB: FloatArray) -> FloatArray | None:
    """Corners (n, 2) of a board at ``X_CB``; None if not all are in the picture."""
    p = BOARD.corners @ X_CB[:3, :3].T + X_CB[:3, 3]
    if p[:, 2].min() < 0.2:
        return None
    pixels = camera.project(p)
    return pixels if np.all((pixels > 8.0) & (pixels < [camera.width - 9.0, camera.height - 9.0])) else None


def poses(seed: int, count: int, *, both: bool = True) -> list[FloatArray]:
    """X_ClB of a board as somebody holds it before the cameras: anywhere in view, near and far, tilted up to 43 deg."""
    rng = np.random.default_rng(seed)
    found: list[FloatArray] = []
    while len(found) < count:
        depth = rng.uniform(0.8, 2.0)
        place = np.array([0.25 / depth, 0.0]) * both + rng.uniform([-1.1, -0.6], [1.1, 0.6])
        X = random_board_pose(BOARD, rng, ray=place, depth=depth, tilt=rng.uniform(0.15, 0.75))
        if seen(LEFT, X) is not None and (not both or seen(RIGHT, inverse(X_CLCR) @ X) is not None):
            found.append(X)
    return found


def view(name: str, camera: CameraModel, X_CB: FloatArray, rng: np.random.Generator, noise: float = NOISE) -> BoardView:
    corners = seen(camera, X_CB)
    assert corners is not None
    noisy = (corners + noise * rng.standard_normal(corners.shape)).astype(np.float32)
    return BoardView(name, (camera.width, camera.height), noisy)


def views(seed: int, count: int = 20, noise: float = NOISE) -> list[BoardView]:
    rng = np.random.default_rng(1000 + seed)
    return [view(f"{k}.png", LEFT, X, rng, noise) for k, X in enumerate(poses(seed, count, both=False))]


def pair_views(seed: int, count: int = 20) -> tuple[list[BoardView], list[BoardView]]:
    rng, held_at = np.random.default_rng(seed), poses(seed, count)
    left = [view(f"l{k}", LEFT, X, rng) for k, X in enumerate(held_at)]
    return left, [view(f"r{k}", RIGHT, inverse(X_CLCR) @ X, rng) for k, X in enumerate(held_at)]


def parameters(camera: CameraModel) -> FloatArray:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def bending(camera: CameraModel) -> FloatArray:
    """Pixels of rays all over the true camera's image [px]."""
    u, v = np.meshgrid(np.linspace(40, WIDTH - 40, 25), np.linspace(30, HEIGHT - 30, 15))
    return camera.pixels(LEFT.rays(np.stack([u, v], axis=-1)))


def test_a_camera_is_found_again_as_exactly_as_stated() -> None:
    """Focal length to 0.1 %, the lens to a pixel everywhere; normalised errors of 12 sets have an RMS of 1."""
    ratios = []
    for seed in range(12):
        found = calibrated(views(seed), BOARD)
        assert (found.camera.fx, found.camera.fy) == pytest.approx((LEFT.fx, LEFT.fy), rel=1e-3)
        # beyond the outermost corners of the boards the lens is an extrapolation
        assert np.abs(bending(found.camera) - bending(LEFT)).max() < 1.0
        assert found.rms == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.15)  # 9 + 120 parameters of 2160 coordinates
        assert found.dropped == {}
        ratios.append((parameters(found.camera) - parameters(LEFT)) / found.std)
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.4


@pytest.mark.parametrize("seed", range(8))
def test_the_right_camera_is_found_in_the_left_one(seed: int) -> None:
    """Its rotation to 0.02 deg and its position to a millimetre; standard deviations that hold."""
    left, right = pair_views(seed)
    found = calibrated_pair(left, right, (calibrated(left, BOARD), calibrated(right, BOARD)), BOARD)
    error = inverse(X_CLCR) @ found.X_ClCr
    turn = rotation_vector(error[:3, :3])
    assert np.degrees(np.abs(turn)).max() < 0.02
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert np.abs(turn).max() < 3.5 * found.rotation_std  # the worst of three angles
    assert found.rotation_std < np.radians(0.015)
    assert found.left.fx == pytest.approx(LEFT.fx, rel=1e-3)
    assert found.right.fx == pytest.approx(RIGHT.fx, rel=1e-3)


@pytest.fixture
def four_threads() -> Iterator[None]:
    """OpenCV on four threads, whatever the machine has."""
    usual = cv2.getNumThreads()
    cv2.setNumThreads(4)
    yield
    cv2.setNumThreads(usual)


@pytest.mark.usefixtures("four_threads")
def test_the_same_photographs_give_the_same_calibration_to_the_bit() -> None:
    """Sums of OpenCV's threads differ in their last bits from call to call; those of a calibration may not."""
    left, right = pair_views(0)
    results = set()
    for _ in range(6):
        cameras = calibrated(left, BOARD), calibrated(right, BOARD)
        pair = calibrated_pair(left, right, cameras, BOARD)
        results.add((cameras[0].camera, cameras[1].camera, pair.left, pair.right, pair.X_ClCr.tobytes()))
    assert len(results) == 1
    assert cv2.getNumThreads() == 4


def test_corners_of_a_photograph_are_where_the_lens_puts_them() -> None:
    """To a few hundredths of a pixel, without a bias that would shift the principal point."""
    rng, errors = np.random.default_rng(2), []
    camera = CameraModel(
        width=640, height=480, fx=420.0, fy=420.0, cx=320.0, cy=240.0, distortion=(-0.15, 0.03, 0, 0, 0)
    )
    for tilt in (0.1, 0.4, 0.7):
        X = random_board_pose(BOARD, rng, ray=np.array([0.1, -0.05]), depth=0.9, tilt=tilt)
        found = board_view("", board_image(BOARD, camera, X, noise_std=2.0, rng=rng), BOARD).corners
        assert found is not None
        true = camera.project(BOARD.corners @ X[:3, :3].T + X[:3, 3])
        errors.append(in_same_order(true.astype(np.float32), found) - true)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.02


def test_an_image_of_something_else_is_dropped_and_named() -> None:
    """One photograph with the corners of a bent board: left out, with its error and that of the others."""
    given = views(3)
    bent = given[7].corners
    assert bent is not None
    given[7] = given[7]._replace(corners=bent + np.float32(0.02) * (bent - bent.mean(axis=0))[:, ::-1])
    found = calibrated(given, BOARD)
    assert list(found.dropped) == ["7.png"]
    assert "the median is 0.0" in found.dropped["7.png"]
    assert found.camera.fx == pytest.approx(LEFT.fx, rel=1e-3)


def test_images_without_the_board_are_dropped_and_named() -> None:
    given = views(1)
    given[4] = given[4]._replace(corners=None)
    assert calibrated(given, BOARD).dropped == {"4.png": "no board of 9x6 corners found"}


def frontal() -> list[BoardView]:
    rng, found = np.random.default_rng(0), []
    for k in range(40):
        place = rng.uniform([-0.8, -0.4], [0.8, 0.4])
        X = random_board_pose(BOARD, rng, ray=place, depth=rng.uniform(0.8, 1.6), tilt=0.02)
        if seen(LEFT, X) is not None:
            found.append(view(f"{k}", LEFT, X, rng))
    return found


def in_the_middle() -> list[BoardView]:
    rng = np.random.default_rng(0)
    return [
        view(f"{k}", LEFT, random_board_pose(BOARD, rng, ray=np.zeros(2), depth=2.2, tilt=rng.uniform(0.3, 0.7)), rng)
        for k in range(15)
    ]


def of_two_sizes() -> list[BoardView]:
    given = views(0)
    return [*given[:5], given[5]._replace(size=(640, 480)), *given[6:]]


BAD_SETS: dict[str, tuple[Callable[[], list[BoardView]], str]] = {
    "nothing": (list, "no images"),
    "too few": (lambda: views(0, 5), "only 5 of 5 images can be used; at least 8 are needed"),
    "no board": (
        lambda: [v._replace(corners=None) for v in views(0)],
        "no image of 20 shows a board of 9x6 inner corners",
    ),
    "few boards": (
        lambda: [v._replace(corners=None) if k > 3 else v for k, v in enumerate(views(0))],
        "only 4 of 20 images can be used",
    ),
    "all frontal": (frontal, "held frontally in all images"),
    "only the middle": (in_the_middle, "cover .* % of the picture"),
    "two sizes": (of_two_sizes, "5.png has 640x480 px, 0.png 1280x720 px"),
    "blurred": (lambda: views(0, noise=1.5), "px RMS off the best camera"),
}


@pytest.mark.parametrize("kind", sorted(BAD_SETS))
def test_poor_sets_are_refused_with_the_reason(kind: str) -> None:
    given, reason = BAD_SETS[kind]
    with pytest.raises(ValueError, match=reason) as refusal:
        calibrated(given(), BOARD)
    assert "\n" not in str(refusal.value)


def test_pairs_taken_at_different_moments_are_refused() -> None:
    """Each camera for itself is fine; together they fit no rigid pair."""
    left, right = pair_views(0, 16)
    cameras = calibrated(left, BOARD), calibrated(right, BOARD)
    with pytest.raises(ValueError, match="px RMS off one pose of the right camera"):
        calibrated_pair(left, [*right[1:], right[0]], cameras, BOARD)
    with pytest.raises(ValueError, match="only 5 pairs can be used; at least 8"):
        calibrated_pair(left[:5], right[:5], cameras, BOARD)
    with pytest.raises(ValueError, match="16 left and 15 right images"):
        calibrated_pair(left, right[1:], cameras, BOARD)


def test_a_board_counted_from_the_other_end_is_turned_round() -> None:
    """OpenCV may begin at either end; both cameras must mean the same corner."""
    corners = view("", LEFT, poses(0, 1)[0], np.random.default_rng(0)).corners
    assert corners is not None
    np.testing.assert_array_equal(in_same_order(corners, corners[::-1]), corners)
    np.testing.assert_array_equal(in_same_order(corners, corners), corners)


def test_boards_that_can_not_be_found_are_refused() -> None:
    with pytest.raises(ValueError, match="2x6"):
        Checkerboard(columns=2, rows=6, square=0.04)
