"""Calibrations and folders of other programs: each gives the same pair of cameras, or one line on what is wrong."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange.recordings.calibrations.found import foreign_files, foreign_rig
from offtrack.exchange.recordings.stereo_reader import open_recording
from sensors.camera.rig import CameraModel
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

SIZE = (160, 96)
K = np.array([[90.0, 0.0, 80.0], [0.0, 91.0, 47.0], [0.0, 0.0, 1.0]])
D = (-0.2, 0.03, 0.001, -0.002)
X_CLCR = transform(rotation_zyx(0.01, -0.02, 0.03), np.array([0.4, 0.01, -0.02]))
X_BCL = transform(rotation_zyx(0.3, 0.2, 0.1), np.array([1.0, 2.0, 3.0]))


def rows(matrix: FloatArray) -> str:
    return json.dumps(matrix.tolist())


def matrix(values: FloatArray) -> str:
    values = np.atleast_2d(values)
    return f"{{rows: {values.shape[0]}, cols: {values.shape[1]}, data: {rows(values.ravel())}}}"


def kalibr(folder: Path, lens: str = "radtan") -> tuple[Path, ...]:
    camera = (
        f"  camera_model: pinhole\n  intrinsics: [90, 91, 80, 47]\n  distortion_model: {lens}\n"
        f"  distortion_coeffs: {list(D)}\n  resolution: [160, 96]\n"
    )
    text = f"cam0:\n{camera}cam1:\n  T_cn_cnm1: {rows(inverse(X_CLCR))}\n{camera}"
    (folder / "camchain.yaml").write_text(text, encoding="utf-8")
    return (folder / "camchain.yaml",)


def euroc(folder: Path) -> tuple[Path, ...]:
    for name, X_BC in (("cam0", X_BCL), ("cam1", X_BCL @ X_CLCR)):
        (folder / name).mkdir()
        text = (
            f"%YAML:1.0\nT_BS: {matrix(X_BC)}\nresolution: [160, 96]\ncamera_model: pinhole\n"
            f"intrinsics: [90, 91, 80, 47]\ndistortion_model: radial-tangential\ndistortion_coefficients: {list(D)}\n"
        )
        (folder / name / "sensor.yaml").write_text(text, encoding="utf-8")
    return folder / "cam0" / "sensor.yaml", folder / "cam1" / "sensor.yaml"


def ros(folder: Path) -> tuple[Path, ...]:
    X_CrCl, lens = inverse(X_CLCR), np.array(D)
    R, T = X_CrCl[:3, :3].copy(), X_CrCl[:3, 3:].copy()
    R_l, R_r, P_l, P_r, *_ = cv2.stereoRectify(K, lens, K, lens, SIZE, R, T)
    for name, R_r_c, P in (("left", R_l, P_l), ("right", R_r, P_r)):
        text = (
            f"image_width: 160\nimage_height: 96\ncamera_name: {name}\ncamera_matrix: {matrix(K)}\n"
            f"distortion_model: plumb_bob\ndistortion_coefficients: {matrix(np.array([*D, 0.0]))}\n"
            f"rectification_matrix: {matrix(np.asarray(R_r_c, dtype=np.float64))}\n"
            f"projection_matrix: {matrix(np.asarray(P, dtype=np.float64))}\n"
        )
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder / "left.yaml", folder / "right.yaml"


def opencv(folder: Path, ending: str) -> tuple[Path, ...]:
    path = folder / f"stereo.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    X_CrCl = inverse(X_CLCR)
    for name, value in (("M1", K), ("D1", np.array([D])), ("M2", K), ("D2", np.array([D])), ("R", X_CrCl[:3, :3]),
                        ("T", X_CrCl[:3, 3:])):  # fmt: skip
        storage.write(name, np.ascontiguousarray(value))
    storage.release()
    return (path,)


def opencv_sample(folder: Path) -> tuple[Path, ...]:
    """Its ``extrinsics.yml`` has R and T, and more."""
    (path,) = opencv(folder, "yml")
    head, motion = path.read_text(encoding="utf-8").split("R: ")
    (folder / "extrinsics.yml").write_text(f"%YAML:1.0\n---\nR: {motion}", encoding="utf-8")
    path.unlink()
    (folder / "intrinsics.yml").write_text(head, encoding="utf-8")
    return (folder / "intrinsics.yml",)


WRITERS: dict[str, Callable[[Path], tuple[Path, ...]]] = {
    "Kalibr": kalibr, "EuRoC": euroc, "ROS": ros, "YAML of OpenCV": lambda folder: opencv(folder, "yml"),
    "XML of OpenCV": lambda folder: opencv(folder, "xml"), "OpenCV's sample": opencv_sample,
}  # fmt: skip


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_each_program_s_file_gives_the_pair_of_cameras(
    tmp_path: Path, write: Callable[[Path], tuple[Path, ...]]
) -> None:
    files = write(tmp_path)
    folders = tuple(tmp_path / name / "data" if len(files) == 2 else tmp_path / name for name in ("cam0", "cam1"))
    if files[0].name == "left.yaml":
        folders = tmp_path / "left", tmp_path / "right"
    assert foreign_files(*folders) == files
    rig = foreign_rig(files, SIZE)
    expected = CameraModel(width=160, height=96, fx=90.0, fy=91.0, cx=80.0, cy=47.0, distortion=(*D, 0.0))
    assert rig.left == rig.right == expected
    np.testing.assert_allclose(rig.X_ClCr, X_CLCR, atol=1e-9)
    assert np.array_equal(foreign_rig(files[:1], SIZE).X_ClCr, rig.X_ClCr)
    if len(files) == 2:
        files[1].unlink()
        with pytest.raises(ValueError, match="calibration of one camera, and none of the right one beside it"):
            foreign_rig(files[:1], SIZE)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[", "not a YAML file"),
        ("- 1", "has no keys"),
        ("cam0: {intrinsics: [1, 2, 3, 4]}\n", "M1, D1, M2, D2, R, T is missing"),
        ("cam0: {intrinsics: [90, 91, 80]}\ncam1: {}\n", "must be 4"),
        ("cam0: {}\ncam1: {}\n", "intrinsics is missing"),
        ("cam0: 7\ncam1: 8\n", "can not be read as the calibration"),
        ("cam0: {camera_model: omni, intrinsics: [90, 91, 80, 47]}\ncam1: {}\n", "camera omni with lens"),
        (f"a: {'[' * 2000}{']' * 2000}", "not a YAML file: line 1: a calibration has no aliases"),
        (f"M1: [{'1,' * 400_000}]", "at most 20000 values"),
        ("a: &a [1, 1]\nb: &b [*a, *a]\nM1: *b\n", "line 2: a calibration has no aliases"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "x.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*x\.yaml[^\n]*$") as refused:
        foreign_rig((tmp_path / "x.yaml",), SIZE)
    assert says in str(refused.value)


def test_a_camera_info_that_is_not_of_a_pair_is_one_line(tmp_path: Path) -> None:
    files = ros(tmp_path)
    head, _ = files[1].read_text(encoding="utf-8").split("projection_matrix")
    files[1].write_text(f"{head}projection_matrix: {matrix(np.zeros((3, 4)))}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*right\.yaml: [^\n]*projection_matrix is empty[^\n]*$"):
        foreign_rig(files, SIZE)


def test_lenses_are_those_that_the_file_names(tmp_path: Path) -> None:
    fisheye = foreign_rig(kalibr(tmp_path, "equidistant"), SIZE).left
    assert (fisheye.fisheye, fisheye.distortion) == (True, D)
    with pytest.raises(ValueError, match="with lens fov: must be a pinhole with plumb_bob, radtan, rational"):
        foreign_rig(kalibr(tmp_path, "fov"), SIZE)


def images(folder: Path, *sides: str) -> None:
    noise = np.random.default_rng(1).integers(0, 256, SIZE[::-1], dtype=np.uint8)
    for side in sides:
        (folder / side).mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(str(folder / side / f"{k:010d}.png"), noise)


def test_raw_data_of_kitti_have_times_beside_the_images_and_a_calibration_of_the_day(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    images(drive, "image_02/data", "image_03/data")
    dates = "".join(f"2011-09-26 13:02:{25 + 0.1 * k:012.9f}\n" for k in range(3))
    (drive / "image_02" / "timestamps.txt").write_text(dates, encoding="utf-8")
    P = [f"P_rect_0{k}: 90 0 80 {-36.0 * (k - 2)} 0 90 47 0 0 0 1 0\n" for k in (2, 3)]
    (tmp_path / "calib_cam_to_cam.txt").write_text("corner_dist: 0.1\n" + "".join(P), encoding="utf-8")
    recording = open_recording(drive)
    assert [frame.tick for frame in recording.sequence.frames] == [0, 100, 200]
    assert (recording.calibration.focal_length, recording.calibration.baseline) == (90.0, 0.4)


def test_a_probe_says_what_was_recognised_and_estimates_nothing(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    images(tmp_path / "mine", "cam_a", "cam_b")
    kalibr(tmp_path / "mine")
    arguments = ["mine", "--folders", "cam_a,cam_b", "--rate", "10", "--facing", "forward", "--probe", "--json"]
    answer = CliRunner().invoke(app, ["estimate", "off-tracking", *arguments])
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["recording"]["images"]["rate_hz"] == 10.0
    assert not found["recording"]["calibration"]["rectified"]
    assert found["recording"]["calibration"]["baseline_m"] == pytest.approx(math.hypot(0.4, 0.01, 0.02), abs=1e-3)
    assert "cameras 0 m behind the hitch (--camera-x)" in found["assumed"]
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    wrong = CliRunner().invoke(app, ["estimate", "off-tracking", "mine", "--folders", "cam_a"])
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (2, 1)
    assert "expected LEFT,RIGHT" in wrong.stderr
