"""Faults of recordings are named: what images, names, times and calibrations show before anything is estimated."""

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple, cast

import cv2
import numpy as np
import pytest

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import RightRotation
from estimators.estimates import Health, Motion, lost_motion
from offtrack.exchange.recordings.estimation import Estimation, _lost_warnings, _rotation_warnings
from offtrack.exchange.recordings.image_checks import (
    Place,
    ground_flow,
    image_warnings,
    lens_warnings,
    projection_warnings,
)
from offtrack.exchange.recordings.layouts.file_pairs import file_pairs
from offtrack.exchange.recordings.layouts.folders import find_sequence
from offtrack.exchange.recordings.layouts.frame_times import read_times
from offtrack.exchange.recordings.stereo_reader import open_recording
from offtrack.exchange.recordings.writers import RoverRecording
from scenarios.image_file import grey_bits, read_grey
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, RoverView, StereoFrame
from sensors.sand.trace_rig import TraceRig, nominal_rig
from vehicle.rover.description import load_rover

WIDTH, HEIGHT = 640, 240
HORIZON = 80  # row; the ground is below it, sky above


def _ground(k: int, side: int) -> GreyImage:
    """Ground seen by cameras that move ahead: rows below the horizon are closer and move faster."""
    noise = np.random.default_rng(7).integers(0, 256, (400, 600), dtype=np.uint8)
    texture = cv2.resize(noise, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    below = np.arange(1.0, HEIGHT - HORIZON)[:, None]
    across = 1200.0 + 600.0 * (np.arange(WIDTH)[None, :] - 0.5 * WIDTH + side * 0.3 * below) / (below + 20.0)
    along = np.broadcast_to(1400.0 - 30.0 * k - 20000.0 / (below + 20.0), across.shape)
    image = np.full((HEIGHT, WIDTH), 200, dtype=np.uint8)
    image[HORIZON + 1 :] = cv2.remap(texture, across.astype(np.float32), along.astype(np.float32), cv2.INTER_LINEAR)
    return image


def _place(change: Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]], late: int = 0) -> Place:
    pairs = [change(_ground(k, 0), _ground(k - late, 1)) for k in (4, 5, 6)]
    frames = [StereoFrame(tick=100 * k, left=left, right=right) for k, (left, right) in enumerate(pairs)]
    return lambda step: frames[1 + step]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda left, right: (left, right), ""),
        (lambda left, right: (right, left), "disparities are negative: are left and right exchanged"),
        (lambda left, right: (left, left), "left and right images are the same"),
        (lambda left, right: (left, np.roll(right, 8, axis=0)), "differ by 8"),
        (lambda left, right: (right[::-1, ::-1], left[::-1, ::-1]), "the ground is above the cameras"),
        (lambda left, right: (left // 60, right // 60), "hardly any contrast"),
        (lambda left, _: (left, _noise()), "hardly a feature in common"),
    ],
    ids=["sound", "exchanged", "same", "rows", "upside down", "dark", "unrelated"],
)  # fmt: skip
def test_images_show_their_fault(
    change: Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]], says: str
) -> None:
    found = image_warnings([_place(change)] * 2, ground_below=True)
    assert [says in line for line in found] == ([True] if says else []), found


@pytest.mark.parametrize(("raw", "rectified", "doubted"), [(0, 4, True), (4, 0, False), (0, 0, False)])
def test_images_whose_rows_agree_as_they_are_but_not_once_rectified_are_doubted(
    raw: int, rectified: int, doubted: bool
) -> None:
    left, right = _ground(5, 0), _ground(5, 1)
    frames = [StereoFrame(tick=0, left=left, right=np.roll(right, k, axis=0)) for k in (raw, rectified)]
    found = lens_warnings(frames[:1], frames[1:])
    assert ["are they rectified already" in line for line in found] == [True] * doubted


@pytest.mark.parametrize(("late", "place"), [(1, "before"), (-1, "after")])
def test_right_images_of_a_neighbouring_frame_are_noticed(late: int, place: str) -> None:
    found = image_warnings([_place(lambda left, right: (left, right), late)] * 2, ground_below=True)
    assert [f"of the frame {place} theirs" in line for line in found] == [True], found


def test_a_right_image_that_is_lost_under_way_is_noticed() -> None:
    sound, late = (_place(lambda left, right: (left, right), k) for k in (0, 1))
    found = image_warnings([sound, sound, late], ground_below=True)
    assert ["of the frame before theirs" in line for line in found] == [True], found


@pytest.mark.parametrize(
    ("motions", "says"),
    [
        ([(0, Health.OK), (100, Health.OK), (200, Health.OK)], ""),
        ([(0, Health.OK), (100, Health.OK), (1900, Health.OK)], "no motion was found for 1.7 s from 0.2 s on"),
        ([(0, Health.OK), (100, Health.DEGRADED), (200, Health.DEGRADED)], "2 of 3 motions are degraded"),
    ],
)
def test_a_path_that_is_a_guess_is_said(motions: list[tuple[int, Health]], says: str) -> None:
    """Motions of 0.1 s each; of the frames after a gap the first one gives none."""
    frames = [
        SimpleNamespace(
            files=SimpleNamespace(tick=begin + 100),
            motion=replace(lost_motion(begin + 100, begin), health=health),
            dropped="",
        )
        for begin, health in motions
    ]
    estimation = SimpleNamespace(frames=frames, states_motions=True, recording=SimpleNamespace(warnings=()))
    found = _lost_warnings(cast(Estimation, estimation))
    assert [says in line for line in found] == ([True] if says else []), found


@pytest.mark.parametrize(("angle", "warned"), [(0.5, False), (1.6, True)])
def test_a_rotation_that_no_rigid_mount_allows_is_said_though_it_was_corrected(angle: float, warned: bool) -> None:
    turned = RightRotation(0.0, math.radians(angle), 0.0)
    motion = SelfCalibratedMotion(
        **{field.name: getattr(lost_motion(0, 100), field.name) for field in fields(Motion)},
        right_rotation=turned, right_rotation_std=turned, right_delay=0.0, right_delay_std=1.0, miscalibrated=False,
    )  # fmt: skip
    found = _rotation_warnings(cast(Estimation, SimpleNamespace(frames=[SimpleNamespace(motion=motion)])))
    assert ["1.6 deg" in line for line in found] == [True] * warned


SAND = 260  # px of ground a metre


class _Drive(NamedTuple):
    """A rover's recording in memory: a camera that looks straight down, 1 m above textured ground."""

    images: list[GreyImage]
    rig: TraceRig
    change: Callable[[GreyImage], GreyImage]
    turn: float = 0.01  # from image to image [rad]

    def view(self, k: int) -> RoverView:
        return RoverView(tick=100 * k, image=self.change(self.images[k]), heading=self.turn * k,
                         wheel_speeds=np.full(4, 3.0), steer=np.zeros(4))  # fmt: skip


@pytest.fixture(scope="module")
def drive() -> _Drive:
    """In a bend to the left."""
    return _drive(0.01)


def _drive(turn: float) -> _Drive:
    """3 cm and a turn [rad] from image to image."""
    rig = nominal_rig(load_rover("el_dorado_ii"))
    noise = np.random.default_rng(3).integers(0, 256, (500, 500), dtype=np.uint8)
    ground = cv2.resize(noise, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    to_texture = np.array([[SAND, 0.0, 1000.0], [0.0, SAND, 1000.0], [0.0, 0.0, 1.0]])
    images, pose = [], np.eye(3)
    for _ in range(8):
        H = rig.image_of_ground() @ np.linalg.inv(to_texture @ pose)
        image = cv2.warpPerspective(ground, H, (rig.camera.width, rig.camera.height))
        images.append(np.asarray(image, dtype=np.uint8))
        c, s = math.cos(turn), math.sin(turn)
        pose = pose @ np.array([[c, -s, 3.0 * rig.wheel_radius * 0.1], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return _Drive(images, rig, lambda image: image)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda image: image, ""),
        (lambda image: image[::-1, ::-1], "upside down"),
        (lambda image: image[::-1], "upside down"),
        (lambda image: image[:, ::-1], "mirrored"),
    ],
)
def test_ground_that_moves_the_wrong_way_is_noticed(
    drive: _Drive, change: Callable[[GreyImage], GreyImage], says: str
) -> None:
    found = ground_flow(cast(RoverRecording, drive._replace(change=change)))
    assert [says in line for line in found.warnings] == ([True] if says else [])
    assert not found.notes


@pytest.mark.parametrize("change", [lambda image: image, lambda image: image[:, ::-1]])
def test_a_drive_straight_on_does_not_tell_whether_images_are_mirrored(
    change: Callable[[GreyImage], GreyImage],
) -> None:
    found = ground_flow(cast(RoverRecording, _drive(0.0)._replace(change=change, turn=0.0)))
    assert found.warnings == ()
    assert ["can not be decided" in line for line in found.notes] == [True]


def test_ground_that_moves_less_far_than_the_wheels_is_noticed(drive: _Drive) -> None:
    found = ground_flow(cast(RoverRecording, drive._replace(rig=replace(drive.rig, wheel_radius=0.6))))
    assert ["times as far" in line for line in found.warnings] == [True]


def _noise() -> GreyImage:
    return np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


@pytest.mark.parametrize(
    ("cx", "cy", "baseline", "lines"),
    [(310.0, 125.0, 0.5, 0), (607.0, 125.0, 0.5, 1), (310.0, 20.0, 0.5, 1), (310.0, 125.0, 4.4, 1)],
)
def test_a_calibration_of_another_size_or_unit_is_doubted(cx: float, cy: float, baseline: float, lines: int) -> None:
    calibration = StereoCalibration(
        width=WIDTH, height=HEIGHT, focal_length=500.0, cx=cx, cy=cy, baseline=baseline, X_SC=np.eye(4)
    )
    assert len(projection_warnings(calibration, None)) == lines


@pytest.mark.parametrize("factor", [1000.0, 100.0, 0.001])
def test_a_baseline_in_another_unit_is_refused(tmp_path: Path, factor: float) -> None:
    for side in (0, 1):
        (tmp_path / f"image_{side}").mkdir()
        cv2.imwrite(str(tmp_path / f"image_{side}" / "0.png"), _ground(0, side))
    rows = "".join(f"P{k}: 500 0 320 {-250.0 * k * factor} 0 500 120 0 0 0 1 0\n" for k in (0, 1))
    (tmp_path / "calib.txt").write_text(rows, encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*baseline [0-9.]+ m must be 0\.005 to 5 m: is the calibration in mm"):
        open_recording(tmp_path, rate_hz=10.0)


NAMES = {
    "Unix time with a fraction": (["1403636579.9.png", "1403636580.05.png"], ["1403636579.9.png", "1403636580.05.png"]),
    "date and time": (["11-09-26_13-02-59.9.png", "11-09-26_13-03-00.1.png"],) * 2,
    "stamp and number": (["1403636579000000000_7.png", "1403636579100000000_2.png"],) * 2,
    "no zeros ahead": (["img9.png", "img10.png"],) * 2,
    "own stamps": (
        ["1403636579000000000.png", "1403636579100000000.png"],
        ["1403636579002000000.png", "1403636579102000000.png"],
    ),
    "own numbers": (["L000000.png", "L000001.png"], ["R000001.png", "R000002.png"]),
    "size in the name": (
        ["left_9_640x240.png", "left_10_640x240.png"],
        ["right_9_640x240.png", "right_10_640x240.png"],
    ),
}


@pytest.mark.parametrize(("left", "right"), NAMES.values(), ids=NAMES)
def test_names_give_pairs_in_the_order_of_time(left: Sequence[str], right: Sequence[str]) -> None:
    pairs = file_pairs([Path(name) for name in sorted(left)], [Path(name) for name in sorted(right)])
    for side, names in ((pairs.left, left), (pairs.right, right)):
        assert [side[key].name for key in sorted(side)] == names
    assert pairs.left.keys() == pairs.right.keys()


def test_what_has_no_partner_is_said_and_what_can_not_be_paired_is_refused() -> None:
    left = [Path(f"{1403636579 + k}000000000.png") for k in range(5)]
    right = [Path(f"{1403636579 + k}003000000.png") for k in (0, 1, 2, 4)]
    pairs = file_pairs(left, right)
    assert len(pairs.left) == len(pairs.right) == 4
    assert pairs.notes == ("paired by time stamps, 3 ms apart; 1 images have no partner",)
    assert np.diff(pairs.times).tolist() == [1.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="do not tell which are pairs"):
        file_pairs([Path(f"{k}.png") for k in range(5)], [Path(f"{k}.png") for k in range(70, 76)])


@pytest.mark.parametrize(
    "rows",
    [
        ["1403636579.5", "1403636579.6"],
        ["1403636579500000000", "1403636579600000000"],
        ["1403636579500000", "1403636579600000"],
        ["1403636579500", "1403636579600"],
        ["# id time exposure", "00000 1403636579.5 7", "00001 1403636579.6 7"],
        ["#timestamp [ns],filename", "1403636579500000000,a.png", "1403636579600000000,b.png"],
        ["# timestamp filename", "1403636579.5 rgb/a.png", "1403636579.6 rgb/b.png"],
        ["2014-06-24 19:02:59.500000000", "2014-06-24 19:02:59.600000000"],
        ["2014-06-24T19:02:59.5", "2014-06-24T19:02:59.6"],
        ["2014-06-24T19:02:59.5Z", "2014-06-24T19:02:59.6Z"],
        ["2014-06-24T21:02:59.5+02:00", "2014-06-24T21:02:59.6+02:00"],
        ["frame,time_s", "0,1403636579.5", "1,1403636579.6"],
        ["1403636579,5", "1403636579,6"],
    ],
    ids=["s", "ns", "us", "ms", "DSO", "EuRoC", "TUM", "KITTI raw", "ISO 8601", "UTC", "time zone", "names", "comma"],
)
def test_tables_of_times_are_read_in_their_unit(tmp_path: Path, rows: list[str]) -> None:
    (tmp_path / "times.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert read_times(tmp_path / "times.txt").times == pytest.approx([1403636579.5, 1403636579.6], abs=1e-5)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_the_upper_eight_of_the_bits_that_are_used_are_read(tmp_path: Path, bits: int) -> None:
    image = np.arange(256, dtype=np.uint16).reshape(16, 16)
    for side in (0, 1):
        (tmp_path / f"image_{side}").mkdir()
        cv2.imwrite(str(tmp_path / f"image_{side}" / "0.png"), image << (bits - 8))
    path = tmp_path / "image_0" / "0.png"
    assert grey_bits([path]) == bits
    np.testing.assert_array_equal(read_grey(path, bits), image)
    assert find_sequence(tmp_path, 10.0).frames[0].bits == bits
