"""Mounting of recorded cameras: from calibration files, from users, or assumed and said so."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from estimators.estimates import Health, Motion, lost_motion
from offtrack.exchange.recordings.calibrations.kitti import read_projections
from offtrack.exchange.recordings.camera_files import Facing, MountingOptions, Rig, facing_by_motion, mounting, read_rig
from offtrack.exchange.recordings.layouts.folders import FOLDERS
from offtrack.exchange.recordings.stereo_reader import Recording, open_recording
from offtrack.exchange.recordings.writers import calibration_text, rig_text
from sensors.camera.rig import CameraModel, RawStereoRig, StereoCalibration, StereoRig
from sensors.messages import StereoFrame
from vehicle.frames import inverse, rotation_zyx, transform

# calib.txt as the KITTI odometry benchmark has it: a grey pair, and a colour pair that is off it in all three axes
_LINE = "7.188560000000e+02 0 6.071928000000e+02 {:.12e} 0 7.188560000000e+02 1.852157000000e+02 {:.12e} 0 0 1 {:.12e}"
_GREY = ((0.0, 0.0, 0.0), (-386.1448, 0.0, 0.0))
_COLOUR = ((45.38225, -0.1130887, 3.779761e-3), (-337.2877, 2.369057, 4.915215e-3))
KITTI = "".join(f"P{k}: {_LINE.format(*offset)}\n" for k, offset in enumerate((*_GREY, *_COLOUR)))
RIG = StereoRig(facing="left", width=64, height=32, hfov=math.radians(100), x=-7.0, y=1.2, z=3.0, baseline=0.5)
CAMERA = CameraModel(width=64, height=32, fx=40.0, fy=40.0, cx=31.5, cy=15.5, distortion=(-0.1, 0.01, 0.0, 0.0, 0.0))
RAW = RawStereoRig(
    left=CAMERA,
    right=CAMERA,
    X_ClCr=transform(rotation_zyx(0.0, 0.01, 0.02), np.array([0.5, 0.002, 0.0])),
    X_SC=RIG.calibration().X_SC,
)


def images(directory: Path, count: int = 2) -> Path:
    for side in (0, 1):
        (directory / f"image_{side}").mkdir(parents=True)
        for k in range(count):
            cv2.imwrite(str(directory / f"image_{side}" / f"{k:06d}.png"), np.full((32, 64), 100, np.uint8))
    return directory


def opened(directory: Path, **options: float) -> Recording:
    return open_recording(directory, rate_hz=10.0, options=MountingOptions(**options))  # type: ignore[arg-type]


def test_a_calibration_like_the_benchmarks_is_understood(tmp_path: Path) -> None:
    """Its cameras are 0.54 m apart; the colour pair sits 6 cm left of the grey one, of which the poses speak."""
    (tmp_path / "calib.txt").write_text(KITTI, encoding="utf-8")
    grey, colour = (read_projections(tmp_path / "calib.txt", folders, (1241, 376)) for folders in FOLDERS[:2])
    assert grey.focal_length == colour.focal_length == 718.856
    assert (grey.cx, grey.cy) == (607.1928, 185.2157)
    assert grey.baseline == pytest.approx(386.1448 / 718.856)
    np.testing.assert_array_equal(grey.X_SC, np.eye(4))
    left, right = (45.38225 - 607.1928 * 3.779761e-3) / 718.856, (-337.2877 - 607.1928 * 4.915215e-3) / 718.856
    assert colour.X_SC[0, 3] == pytest.approx(-left, rel=1e-9)  # by hand: P = K [I | t], the camera is at -t
    assert colour.baseline == pytest.approx(left - right, rel=1e-9)


def test_the_calibration_of_other_images_is_refused(tmp_path: Path) -> None:
    images(tmp_path)
    (tmp_path / "calib.txt").write_text(KITTI, encoding="utf-8")
    with pytest.raises(ValueError, match=r"607\.193 lies outside images of 64x32 px"):
        opened(tmp_path)
    big = CameraModel(width=640, height=480, fx=400.0, fy=400.0, cx=320.0, cy=240.0)
    raw = RawStereoRig(left=big, right=big, X_ClCr=RAW.X_ClCr, X_SC=RAW.X_SC)
    (tmp_path / "other.toml").write_text(raw.to_toml(), encoding="utf-8")
    with pytest.raises(ValueError, match=r"other\.toml: the left camera has 640x480 px, the images 64x32"):
        open_recording(tmp_path, rate_hz=10.0, calibration_file=tmp_path / "other.toml")


def test_a_recorded_rectified_rig_comes_back(tmp_path: Path) -> None:
    """Calibration, mounting and follow point; nothing has to be assumed."""
    images(tmp_path)
    calibration = RIG.calibration()
    (tmp_path / "calib.txt").write_text(calibration_text(calibration), encoding="utf-8")
    (tmp_path / "rig.toml").write_text(rig_text(calibration, 13.5), encoding="utf-8")
    recording = opened(tmp_path)
    got = recording.calibration
    for name in ("width", "height", "focal_length", "cx", "cy", "baseline"):
        assert getattr(got, name) == pytest.approx(getattr(calibration, name), rel=1e-11)  # twelve digits are written
    np.testing.assert_array_equal(got.X_SC, calibration.X_SC)
    assert recording.follow_distance == 13.5
    assert recording.rectification is None
    assert recording.assumed == ()


def test_a_recorded_raw_rig_comes_back_with_its_rectification(tmp_path: Path) -> None:
    """The rectified left camera is the raw one turned about its optical centre; poses go with it."""
    images(tmp_path)
    (tmp_path / "rig.toml").write_text(rig_text(RAW, 13.5), encoding="utf-8")
    X = transform(rotation_zyx(0.0, 0.3, 0.0), np.array([0.1, 0.0, 2.0]))
    lines = [" ".join(repr(float(x)) for x in pose[:3].ravel()) for pose in (np.eye(4), X)]
    (tmp_path / "poses.txt").write_text("\n".join(lines), encoding="utf-8")
    recording = opened(tmp_path)
    assert recording.rectification is not None
    assert recording.follow_distance == 13.5
    X_SC = recording.calibration.X_SC
    np.testing.assert_allclose(X_SC[:3, 3], RAW.X_SC[:3, 3], atol=1e-12)
    assert not np.allclose(X_SC[:3, :3], RAW.X_SC[:3, :3], atol=1e-4)
    assert recording.poses is not None
    body = X_SC @ recording.poses[1] @ inverse(X_SC)  # the same motion of the trailer, whichever camera shows it
    np.testing.assert_allclose(body, RAW.X_SC @ X @ inverse(RAW.X_SC), atol=1e-12)


def test_poses_of_a_sequence_are_also_found_where_the_benchmark_keeps_them(tmp_path: Path) -> None:
    """dataset/sequences/07 and dataset/poses/07.txt; those of camera 0 are brought to the colour camera."""
    directory = tmp_path / "dataset" / "sequences" / "07"
    for name in ("image_2", "image_3"):
        (directory / name).mkdir(parents=True)
        for k in range(2):
            cv2.imwrite(str(directory / name / f"{k:06d}.png"), np.full((376, 1241), 100, np.uint8))
    (directory / "calib.txt").write_text(KITTI, encoding="utf-8")
    turn = transform(rotation_zyx(0.0, 0.5, 0.0), np.zeros(3))  # about camera 0: the one beside it moves
    (tmp_path / "dataset" / "poses").mkdir()
    lines = [" ".join(repr(float(x)) for x in pose[:3].ravel()) for pose in (np.eye(4), turn)]
    (tmp_path / "dataset" / "poses" / "07.txt").write_text("\n".join(lines), encoding="utf-8")
    recording = open_recording(directory, rate_hz=10.0, options=MountingOptions(facing="front"))
    assert recording.poses is not None
    beside = 0.0599  # [m], see above
    assert np.linalg.norm(recording.poses[1][:3, 3]) == pytest.approx(2 * beside * math.sin(0.25), rel=5e-3)


@pytest.mark.parametrize(
    ("facing", "x", "forward"),
    [
        ("rear", -14.0, (0, 0, -1)),
        ("left", -7.0, (1, 0, 0)),
        ("right", -7.0, (-1, 0, 0)),
        ("front", 0.0, (0, 0, 1)),
        ("down", -7.0, (0, -1, 0)),
    ],
)
def test_what_nobody_has_said_is_assumed_and_named(
    facing: Facing, x: float, forward: tuple[float, float, float]
) -> None:
    """Rear cameras over the follow point, side ones half way, front ones over the hitch; forward as they see it."""
    placed = mounting(MountingOptions(), Rig(), RIG.calibration(), lambda: facing)
    middle = placed.X_SC @ [0.25, 0.0, 0.0, 1.0]
    assert middle[:3] == pytest.approx([x, 0.0, 3.0])
    assert pytest.approx(forward, abs=1e-12) == placed.X_SC[:3, :3].T @ [1.0, 0.0, 0.0]
    assert [line.split("(")[1] for line in placed.assumed] == [
        "--follow-distance)",
        "--facing)",
        "--camera-x)",
        "--camera-height)",
        "--direction-std)",
    ]
    pixel = 1.0 / RIG.calibration().focal_length
    assert placed.direction_std == pytest.approx(math.hypot(pixel, math.radians(0.1)))


@pytest.mark.parametrize(
    ("way", "facing"),
    [
        ((0.1, 0, 1), "front"),
        ((0.3, 0, -1), "rear"),
        ((1, 0, 0.2), "left"),
        ((-1, 0, 0.2), "right"),
        ((0.2, -1, 0), "down"),
        ((0, 0, 0), None),
    ],
)
def test_which_way_cameras_face_is_seen_by_how_they_move(
    way: tuple[float, float, float], facing: Facing | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a vehicle that drives ahead: along their own z if they look there, to the right if they look to the left."""

    class Moving:
        def __init__(self, calibration: StereoCalibration) -> None:
            assert calibration.X_SC[2, 3] > 0.0  # an odometry may insist on being above the ground

        def init(self) -> None:
            return None

        def step(self, memory: None, frame: StereoFrame) -> tuple[None, Motion]:
            X_PC, lost = transform(np.eye(3), 0.4 * np.array(way)), lost_motion(frame.tick, frame.tick - 100)
            return None, replace(lost, X_PC=X_PC, covariance=np.eye(6), health=Health.OK, matches=300, inliers=300)

    monkeypatch.setattr("offtrack.exchange.recordings.camera_files.CircularOdometry", Moving)
    grey = np.zeros((32, 64), np.uint8)
    frames = [StereoFrame(tick=100 * k, left=grey, right=grey) for k in range(10)]
    calibration = replace(RIG.calibration(), X_SC=np.eye(4))
    assert facing_by_motion(calibration, frames) == facing


def test_where_small_images_do_not_show_the_motion_those_of_full_size_do(monkeypatch: pytest.MonkeyPatch) -> None:
    class Sharp:
        def __init__(self, calibration: StereoCalibration) -> None:
            self._health = Health.OK if calibration.width == 1280 else Health.LOST

        def init(self) -> None:
            return None

        def step(self, memory: None, frame: StereoFrame) -> tuple[None, Motion]:
            assert frame.left.shape == ((32, 1280) if self._health is Health.OK else (16, 640))
            moved = transform(np.eye(3), np.array([0.0, 0.0, 0.4]))
            return None, replace(lost_motion(frame.tick, 0), X_PC=moved, health=self._health)

    monkeypatch.setattr("offtrack.exchange.recordings.camera_files.CircularOdometry", Sharp)
    grey = np.zeros((32, 1280), np.uint8)
    frames = [StereoFrame(tick=100 * k, left=grey, right=grey) for k in range(10)]
    assert facing_by_motion(replace(RIG.calibration(), width=1280), frames) == "front"


def test_options_go_before_the_rig_and_leave_nothing_to_assume() -> None:
    options = MountingOptions(follow_distance=9.0, facing="rear", x=-8.0, y=0.1, z=4.2, direction_std=0.002)
    rig = Rig(X_SC=RIG.calibration().X_SC, follow_distance=13.5, direction_std=0.0)
    placed = mounting(options, rig, RIG.calibration(), lambda: pytest.fail("asked"))
    assert placed.follow_distance == 9.0
    assert placed.assumed == ()
    assert placed.direction_std == 0.002
    assert (placed.X_SC @ [0.25, 0.0, 0.0, 1.0])[:3] == pytest.approx([-8.0, 0.1, 4.2])


def test_a_rig_that_is_not_above_the_ground_sits_nowhere_yet(tmp_path: Path) -> None:
    """Whoever calibrates cameras on a table does not know their place on the trailer."""
    table = RawStereoRig(left=CAMERA, right=CAMERA, X_ClCr=RAW.X_ClCr, X_SC=np.eye(4))
    (tmp_path / "rig.toml").write_text(table.to_toml(), encoding="utf-8")
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.X_SC is None
    assert rig.follow_distance is None
    assert rig.raw
