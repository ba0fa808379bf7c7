"""Calibration from pictures of boards, by command and by function, and warnings about a calibration."""

import json
import math
import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import RightRotation
from estimators.calibration.rectification import Rectifier
from estimators.estimates import lost_motion
from estimators.rigid_motion import rotation_vector
from offtrack.commands.cli import app
from scenarios.assembly import trailer_sensors
from scenarios.assembly.trailer_sensors import calibrated_with_boards
from scenarios.results.run_warnings import calibration_warnings
from sensors.camera.calibration_target import Checkerboard, board_image, random_board_pose
from sensors.camera.rig import CameraModel, RawStereoRig, StereoRig, load_raw_rig
from vehicle.frames import inverse, so3_exp, transform

CAMERA = CameraModel(
    width=640, height=400, fx=420.0, fy=421.0, cx=316.0, cy=203.0, distortion=(-0.15, 0.03, 0.0005, -0.0004, 0.0)
)
X_CLCR = transform(so3_exp(np.radians([0.5, -0.8, 0.4])), np.array([0.2, 0.001, -0.002]))
BOARD = Checkerboard(columns=7, rows=5, square=0.05)
GIVEN = ["--board", "7x5", "--square", "0.05"]


def calibrate(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["calibrate", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with left/ and right/: 16 pairs of a hand-held board."""
    folder, rng = tmp_path_factory.mktemp("photos"), np.random.default_rng(5)
    for side in ("left", "right"):
        (folder / side).mkdir()
    for k in range(16):
        depth = rng.uniform(0.6, 0.9)
        place = np.array([0.1 / depth + (-0.36, 0.0, 0.36)[k % 3], (-0.18, 0.0, 0.18)[k // 3 % 3]])
        X = random_board_pose(BOARD, rng, ray=place, depth=depth, tilt=rng.uniform(0.2, 0.6))
        for side, X_CB in (("left", X), ("right", inverse(X_CLCR) @ X)):
            image = board_image(BOARD, CAMERA, X_CB, noise_std=2.0, rng=rng)
            assert cv2.imwrite(str(folder / side / f"{k:02d}.png"), image)
    return folder


@pytest.mark.slow
def test_a_folder_of_pairs_becomes_a_rig_that_can_be_rectified(photos: Path, tmp_path: Path) -> None:
    """The file holds the cameras as they are, and where they are on the trailer as it was given."""
    out = tmp_path / "my_rig.toml"
    result = calibrate(photos, *GIVEN, "--position=-13.5,0.1,3.2", "--out", out)
    assert result.exit_code == 0, result.output
    rig = load_raw_rig(out)
    assert rig.left.fx == pytest.approx(CAMERA.fx, rel=2e-3)  # small pictures, few of them: twice the usual
    error = inverse(X_CLCR) @ rig.X_ClCr
    assert np.degrees(np.abs(rotation_vector(error[:3, :3]))).max() < 0.05
    assert rig.baseline == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(rig.X_SC[:3, 3], [-13.5, 0.1, 3.2])
    np.testing.assert_allclose(rig.X_SC[:3, 2], [-1.0, 0.0, 0.0], atol=1e-12)  # looks to the rear
    assert Rectifier(rig).calibration.baseline == rig.baseline
    assert (tmp_path / "my_rig_coverage.png").stat().st_size > 10_000
    for told in ("left/00.png", "right/15.png", "fx [px]", "angles +-", str(out.name)):
        assert told in result.output.replace("\n", "")
    assert "assumed" not in result.output


def test_one_camera_alone(photos: Path, tmp_path: Path) -> None:
    """Files by name; its own file, which says how well each number is known."""
    out = tmp_path / "camera.toml"
    result = calibrate(*sorted((photos / "left").iterdir()), *GIVEN, "--out", out, "--quiet")
    assert result.exit_code == 0, result.output
    assert result.output == ""
    text = out.read_text(encoding="utf-8")
    assert "[camera]" in text
    assert "[standard_deviation]" in text


def test_a_blind_image_is_named_and_the_rest_goes_on(photos: Path, tmp_path: Path) -> None:
    """In the JSON, which is all that is printed."""
    copy = shutil.copytree(photos, tmp_path / "photos")
    cv2.imwrite(str(copy / "right" / "03.png"), np.full((400, 640), 90, np.uint8))
    sides = copy / "left", "--right", copy / "right"
    numbers = json.loads(calibrate(*sides, *GIVEN, "--json", "--out", tmp_path / "rig.toml").stdout)
    for part in ("right", "pair"):
        reasons = {Path(name).name: reason for name, reason in numbers[part]["dropped"].items()}
        assert reasons["03.png"] == "no board of 7x5 corners found"
    assert numbers["pair"]["rms_px"] < 0.1
    assert len(numbers["left"]["errors_px"]) + len(numbers["left"]["dropped"]) == 16
    assert numbers["file"].endswith("rig.toml")


def test_too_few_images_are_refused(photos: Path, tmp_path: Path) -> None:
    some, out = sorted((photos / "left").iterdir()), tmp_path / "rig.toml"
    result = calibrate(*some[:4], *GIVEN, "--out", out)
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "only 4 of 4 images can be used; at least 8 are needed" in result.stderr
    assert not out.exists()


@pytest.mark.parametrize("listed", ["folder", "list", "option"])
def test_two_cameras_in_one_folder_are_pairs_by_their_numbers(photos: Path, tmp_path: Path, listed: str) -> None:
    """One image is missing on each side; the shell has expanded ``--right right*.png`` to one value and more images."""
    for side, missing in (("left", 3), ("right", 9)):
        for k in set(range(16)) - {missing}:
            shutil.copy(photos / side / f"{k:02d}.png", tmp_path / f"{side}{k}.png")
    left, right = (sorted(tmp_path.glob(f"{side}*.png")) for side in ("left", "right"))
    lists: dict[str, list[object]] = {
        "folder": [tmp_path], "list": [*left, *right], "option": [*left, "--right", *right],
    }  # fmt: skip
    given = lists[listed]
    numbers = json.loads(calibrate(*given, *GIVEN, "--json", "--out", tmp_path / "rig.toml").stdout)
    assert len(numbers["pair"]["errors_px"]) + len(numbers["pair"]["dropped"]) == 14
    assert numbers["pair"]["rms_px"] < 0.1
    assert numbers["notes"] == ["no partner, not used: left9.png, right3.png"]


def test_a_coefficient_that_the_boards_do_not_determine_stays_at_zero(photos: Path, tmp_path: Path) -> None:
    """The lens has no k3: what a fit finds for it is noise."""
    found = json.loads(calibrate(photos / "left", *GIVEN, "--json", "--out", tmp_path / "camera.toml").stdout)["camera"]
    assert (found["distortion"][4], found["std"][8]) == (0.0, 0.0)
    assert found["note"] == "k3 is left at 0: the photographs do not determine it"
    assert found["rms_px"] < 0.1


def small(baseline: float = 0.5) -> RawStereoRig:
    """Half the resolution of the usual cameras."""
    place = {"x": -14.0, "y": 0.0, "z": 4.2, "baseline": baseline}
    rig = StereoRig(facing="rear", width=672, height=240, hfov=math.radians(100.0), **place)
    return rig.raw((-0.12, 0.01, 0.0005, -0.0005, 0.0))


@pytest.mark.slow
def test_cameras_are_found_again_near_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotation to some 0.03 deg, which self-calibration reduces later; a millimetre in 0.5 m: 0.2 % of all depths.

    A point 20 m behind the trailer is where the calibrated left camera's ray to its true image goes: within 2 cm.
    Principal point and pose on the trailer may each be off by more, as long as they make up for one another.
    """
    monkeypatch.setattr(trailer_sensors, "_HELD", 14)  # fewer pictures than a run takes: a third of the time
    monkeypatch.setattr(trailer_sensors, "_SURVEYED", 6)
    reports: list[tuple[float, float]] = []
    true = small()
    found = calibrated_with_boards(
        true,
        noise_std=2.0,
        rng=np.random.default_rng(1),
        progress=lambda done, total, *_: reports.append((done, total)),
    )
    assert reports == [(k + 1, 20) for k in range(20)]
    error = inverse(true.X_ClCr) @ found.rig.X_ClCr
    assert np.abs(rotation_vector(error[:3, :3])).max() < 3.0 * found.rotation_std
    assert 0.0 < math.degrees(found.rotation_std) < 0.05  # 14 pairs at half the resolution
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert found.rms < 0.15  # corners at a few hundredths of a pixel; misplaced ones would show [px]
    assert np.abs(found.rig.X_ClCr - true.X_ClCr).max() > 1e-6  # corners are noisy: it is no copy
    assert found.rig.left.cx != true.left.cx
    for y in (0.0, 10.0, -10.0):
        in_camera = inverse(true.X_SC) @ np.array([-34.0, y, 1.0, 1.0])
        ray = found.rig.left.rays(true.left.project(in_camera[None, :3]))[0]
        seen = found.rig.X_SC @ np.append(in_camera[2] * np.append(ray, 1.0), 1.0)
        assert abs(seen[1] - y) < 0.02
        assert abs(seen[2] - 1.0) < 0.03


def test_a_rig_that_no_board_fits_before_is_refused() -> None:
    """Cameras 5 m apart see nothing of the same board within 4.5 m."""
    with pytest.raises(ValueError, match="boards: no position found"):
        calibrated_with_boards(small(baseline=5.0), noise_std=2.0, rng=np.random.default_rng(1))


def motion(tick: int, **changes: Any) -> SelfCalibratedMotion:
    plain = lost_motion(tick, tick - 100)
    values: dict[str, Any] = {field.name: getattr(plain, field.name) for field in fields(plain)}
    values |= {"right_rotation": RightRotation(0.0, float(np.radians(0.09)), 0.0), "miscalibrated": False}
    values |= {"right_rotation_std": RightRotation(1e-4, 1e-4, 1e-4), "right_delay": 0.0, "right_delay_std": 1e-3}
    return SelfCalibratedMotion(**(values | changes))


SOUND = [motion(100 * k) for k in range(9)]


@pytest.mark.parametrize(
    ("motions", "says"),
    [
        ([None, lost_motion(100, 0), *SOUND], []),
        ([*SOUND, motion(900, miscalibrated=True), motion(901, miscalibrated=True)], []),
        ([motion(k, right_delay=3e-3) for k in range(9)], []),  # 3 sigma
        (
            [motion(100 * k, miscalibrated=k >= 5) for k in range(10)],
            ["roll 0.00, yaw 0.09, pitch 0.00 deg", "5 of 10 motions", "or do this"],
        ),
        (
            [motion(k, right_delay=0.02 + 1e-3 * k) for k in range(4)],  # the newest significant value counts
            ["23.0 ms after the left one (standard deviation 1.0 ms)"],
        ),
        ([motion(k, right_delay=-0.02) for k in range(4)], ["before the left one"]),
    ],
)
def test_refuted_calibrations_and_late_images_are_warned_of(motions: list[Any], says: list[str]) -> None:
    """With their remedy; sound cameras and single doubtful motions are not."""
    lines = calibration_warnings(motions, "do this")
    assert len(lines) == bool(says)
    assert all(part in lines[0] for part in says)
