"""ROS 2 bags and MCAP: runs read by other packages, and bags by ``offtrack estimate``; bags of others."""

import hashlib
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange.recordings.image_checks import rows_apart
from offtrack.exchange.recordings.layouts import bags
from offtrack.exchange.recordings.layouts.bag_topics import parsed_topics
from offtrack.exchange.recordings.layouts.folders import find_sequence
from offtrack.exchange.recordings.layouts.found import unpacked
from offtrack.exchange.recordings.stereo_reader import open_recording
from offtrack.exchange.recordings.stereo_sequence import Wanted
from scenarios.image_file import read_grey
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log, Signal, write_log
from tests.fuzz.mutations import other_thing

rosbags = pytest.importorskip("rosbags.rosbag2", reason="bags need the extra 'export'")
typesys = pytest.importorskip("rosbags.typesys")

pytestmark = pytest.mark.slow

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
HEIGHT, WIDTH = 48, 64
K = np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]])
D = np.array([-0.2, 0.05, 0.001, -0.002, 0.0])
IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
Messages = list[tuple[str, str, int, Any]]  # topic, kind, stamp [ns] and message


def picture(k: int, side: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.random.default_rng((k, side)).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(stamp: int) -> Any:
    time = make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make("std_msgs/msg/Header", stamp=time, frame_id="cam")


def image(k: int, side: int, stamp: int, **changes: Any) -> Any:
    fields = {"height": HEIGHT, "width": WIDTH, "encoding": "mono8", "is_bigendian": 0, "step": WIDTH,
              "data": picture(k, side).ravel()}  # fmt: skip
    return make(IMAGE, header=header(stamp), **(fields | changes))


def info(side: int, **changes: Any) -> Any:
    P = np.column_stack([K, [-30.0 * side, 0.0, 0.0]])
    fields = {"height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob", "d": D, "k": K.ravel(),
              "r": np.eye(3).ravel(), "p": P.ravel()}  # fmt: skip
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make(INFO, header=header(0), **({"binning_x": 0, "binning_y": 0, "roi": roi} | fields | changes))


def stereo(frames: int = 4, *, right_late: int = 0, **changes: Any) -> Messages:
    """Messages of a stereo camera at 10 Hz under the names of ROS's image_pipeline."""
    told: Messages = [
        (f"/stereo/{name}/camera_info", INFO, 0, info(side)) for side, name in enumerate(("left", "right"))
    ]
    for k in range(frames):
        for side, name in enumerate(("left", "right")):
            stamp = 10**9 + k * 10**8 + side * right_late
            told.append((f"/stereo/{name}/image_raw", IMAGE, stamp, image(k, side, stamp, **changes)))
    return told


def bag(folder: Path, messages: Messages) -> Path:
    with rosbags.Writer(folder, version=rosbags.Writer.VERSION_LATEST) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], stamp, STORE.serialize_cdr(message, kind))
    return folder


def finished_run(folder: Path) -> Path:
    """A run's directory with a log of one second and the images of its recording in ``images``."""
    scenario, images = load_scenario("constant-slip", ("off_tracking=truth",)), folder / "images"
    (folder / "scenario.toml").write_text(scenario.to_toml(), encoding="utf-8")
    time, units = np.arange(0.0, 1.0, 0.01), ("tractor", "semitrailer")
    names = [f"{name}_{unit}" for unit in units for name in ("x", "y", "psi", "v_x", "v_y", "yaw_rate")]
    rows = np.column_stack([time, *(time + k for k in range(len(names))), np.where(time < 0.5, np.nan, time)])
    signals = [Signal("time", "s", "time"), *(Signal(name, "m", name) for name in names), Signal("value", "m", "v")]
    write_log(Log(tuple(signals), rows), folder / "signals.parquet")
    for side in (0, 1):
        (images / f"image_{side}").mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(str(images / f"image_{side}" / f"{k:06d}.png"), picture(k, side))
    (images / "times.txt").write_text("0.0\n0.123456789\n0.2\n", encoding="utf-8")
    calibration = "".join(f"P{k}: 60 0 31.5 {-30.0 * k} 0 60 23.5 0 0 0 1 0\n" for k in (0, 1))
    (images / "calib.txt").write_text(calibration, encoding="utf-8")
    pose = "X_SC = [[0.0, 0.0, -1.0, -14.0], [1.0, 0.0, 0.0, -0.25], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]]\n"
    (images / "rig.toml").write_text(pose, encoding="utf-8")
    digest = hashlib.sha256(b"".join(picture(k, side).tobytes() for k in range(3) for side in (0, 1)))
    (folder / "manifest.json").write_text(json.dumps({"frames_sha256": digest.hexdigest()}), encoding="utf-8")
    return folder


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    run = finished_run(tmp_path)
    arguments = ["export", str(run), "--to", "rosbag2", "--images", str(run / "images"), "--quiet"]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    return run / "rosbag2"


def test_a_bag_gives_the_recording_again(exported: Path) -> None:
    recording = exported.parent / "images"
    with unpacked(exported) as (folder, _):
        assert (folder / "calib.txt").read_bytes() == (recording / "calib.txt").read_bytes()
        assert np.loadtxt(folder / "times.txt").tolist() == [0.0, 0.123456789, 0.2]
        for side in (0, 1):
            files = sorted((folder / f"image_{side}").iterdir())
            assert len(files) == 3
            for k, file in enumerate(files):
                np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), picture(k, side))
    assert not folder.exists()


def test_a_bag_is_read_by_another_package(exported: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="not installed: pip install mcap-ros2-support")
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, Any]]] = {}
    with next(exported.glob("*.mcap")).open("rb") as file:
        for _, channel, message, told in make_reader(
            file, decoder_factories=[decoder.DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, told))
    time = np.arange(0.0, 1.0, 0.01)
    assert [(stamp, told.data) for stamp, told in found["/signals/value"]] == [
        (round(1e9 * t), t) for t in time[50:].tolist()
    ]
    assert [told.data for _, told in found["/signals/v_y_semitrailer"]] == (time + 10).tolist()
    pose = found["/odom/semitrailer"][1][1]
    assert (pose.pose.pose.position.x, pose.twist.twist.linear.y) == (0.02 + 6.0, 0.02 + 10.0)
    turn = pose.pose.pose.orientation
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(0.02 + 8.0 - 4.0 * math.pi)
    assert '"unit": "m"' in found["/signals_units"][0][1].data
    assert len(found["/path/hitch"][0][1].poses) == 100
    assert bytes(found["/camera/right/image_raw"][2][1].data) == picture(2, 1).tobytes()
    assert found["/camera/right/camera_info"][0][1].p[3] == -30.0


def test_raw_images_are_rectified_by_their_camera_info(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", stereo(right_late=10_000_000))
    maps = cv2.initUndistortRectifyMap(K, D, np.eye(3), K, (WIDTH, HEIGHT), cv2.CV_32FC1)
    with unpacked(folder) as (found, _):
        for side in (0, 1):
            files = sorted((found / f"image_{side}").iterdir())
            assert len(files) == 4
            expected = cv2.remap(picture(1, side), *maps, cv2.INTER_LINEAR)
            np.testing.assert_array_equal(cv2.imread(str(files[1]), cv2.IMREAD_UNCHANGED), expected)
        assert "3.150000000000e+01 -3.000000000000e+01 " in (found / "calib.txt").read_text(encoding="utf-8")


def test_topics_can_be_chosen_and_images_compressed_or_coloured(tmp_path: Path) -> None:
    """Colour weighs as OpenCV weighs; a PNG is its pixels; rectified images stay as they are."""
    colours = np.repeat(picture(0, 0)[:, :, None], 3, axis=2)
    png = np.asarray(cv2.imencode(".png", picture(0, 1))[1]).ravel()
    told: Messages = [("/a/info", INFO, 0, info(0, d=np.zeros(5))), ("/b/info", INFO, 0, info(1, d=np.zeros(5)))]
    for k in range(3):
        stamp = 10**8 * (k + 1)
        colour = image(0, 0, stamp, encoding="bgr8", step=3 * WIDTH, data=colours.ravel())
        told += [("/a", IMAGE, stamp, colour),
                 ("/b", COMPRESSED, stamp, make(COMPRESSED, header=header(stamp), format="png", data=png))]  # fmt: skip
    chosen = parsed_topics("left=/a, right=/b,left_info=/a/info,right_info=/b/info")
    with unpacked(bag(tmp_path / "bag", told), Wanted(chosen)) as (folder, _):
        for side in (0, 1):
            for file in (folder / f"image_{side}").iterdir():
                np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), picture(0, side))


def scene(k: int, side: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A wall with texture, 12 px nearer to the left edge for the right camera, that moves from frame to frame."""
    noise = np.random.default_rng(5).integers(0, 256, (60, 80), dtype=np.uint8)
    wall = cv2.resize(noise, (640, 480), interpolation=cv2.INTER_CUBIC)
    return np.asarray(wall[k : k + 300, 50 + 12 * side : 450 + 12 * side])


def scenes(told: Callable[[np.ndarray[Any, Any], int], Any], *infos: Any, name: str = "image_raw") -> Messages:
    kind = COMPRESSED if "compressed" in name else IMAGE
    messages: Messages = [(f"/cam/{s}/camera_info", INFO, 0, i) for s, i in zip(("left", "right"), infos, strict=True)]
    for k in range(3):
        for side, camera in enumerate(("left", "right")):
            stamp = 10**9 + k * 10**8
            messages.append((f"/cam/{camera}/{name}", kind, stamp, told(scene(k, side), stamp)))
    return messages


def sent(pixels: np.ndarray[Any, Any], stamp: int, encoding: str = "mono8") -> Any:
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
    return image(0, 0, stamp, height=height, width=width, encoding=encoding, step=data.size // height, data=data)


def wall_info(side: int, scale: float = 1.0, offset: float = 0.0, **changes: Any) -> Any:
    """Calibration of the scene, or of a sensor with ``scale`` times its pixels and ``offset`` more at two edges."""
    K_wall = np.array([[300.0, 0.0, 199.5], [0.0, 300.0, 149.5], [0.0, 0.0, 1.0]])
    seen = np.array([[1.0, 0.0, offset], [0.0, 1.0, offset], [0.0, 0.0, 1.0]]) @ np.diag([scale, scale, 1.0])
    P = seen @ np.column_stack([K_wall, [-60.0 * side, 0.0, 0.0]])
    size = {"height": round(300 * scale + 2 * offset), "width": round(400 * scale + 2 * offset)}
    return info(side, **({"k": (seen @ K_wall).ravel(), "p": P.ravel(), "d": np.zeros(5)} | size | changes))


def region(offset: int, width: int, height: int) -> Any:
    return make("sensor_msgs/msg/RegionOfInterest", x_offset=offset, y_offset=offset, width=width, height=height,
                do_rectify=False)  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"scale": 2.0, "binning_x": 2, "binning_y": 2},
        {"offset": 40.0, "roi": region(40, 400, 300)},
        {"scale": 2.0, "offset": 40.0, "roi": region(40, 800, 600), "binning_x": 2, "binning_y": 2},
    ],
    ids=["whole", "binning", "region", "both"],
)
def test_binning_and_region_of_interest_scale_the_calibration(tmp_path: Path, changes: dict[str, Any]) -> None:
    told = scenes(sent, *(wall_info(side, **changes) for side in (0, 1)))
    with unpacked(bag(tmp_path / "bag", told)) as (folder, notes):
        assert notes == ()
        for line, side in zip((folder / "calib.txt").read_text(encoding="utf-8").splitlines(), (0, 1), strict=True):
            expected = [300, 0, 199.5, -60 * side, 0, 300, 149.5, 0, 0, 0, 1, 0]
            assert [float(v) for v in line.split()[1:]] == pytest.approx(expected)


ENCODED: dict[str, Callable[[np.ndarray[Any, Any], int], Any]] = {
    "mono16, 12 bits": lambda pixels, t: sent(pixels.astype(np.uint16) << 4, t, "mono16"),
    "mono16, 10 bits": lambda pixels, t: sent(pixels.astype(np.uint16) << 2, t, "mono16"),
    "rgb16": lambda pixels, t: sent(np.repeat(pixels.astype(np.uint16)[..., None] << 8, 3, 2), t, "rgb16"),
    "yuv422": lambda pixels, t: sent(np.stack([np.full_like(pixels, 128), pixels], 2), t, "yuv422"),
    "yuv422_yuy2": lambda pixels, t: sent(np.stack([pixels, np.full_like(pixels, 128)], 2), t, "yuv422_yuy2"),
    "8UC4": lambda pixels, t: sent(np.repeat(pixels[..., None], 4, 2), t, "8UC4"),
}


@pytest.mark.parametrize("told", ENCODED.values(), ids=ENCODED)
def test_images_of_every_encoding_are_the_same_grey(
    tmp_path: Path, told: Callable[[np.ndarray[Any, Any], int], Any]
) -> None:
    messages = scenes(told, wall_info(0), wall_info(1))
    with unpacked(bag(tmp_path / "bag", messages)) as (folder, _):
        frames = find_sequence(folder).frames
        assert [frame.tick for frame in frames] == [0, 100, 200]
        for k, frame in enumerate(frames):
            assert np.abs(read_grey(frame.left, frame.bits).astype(int) - scene(k, 0)).max() <= 1


def mosaic(pixels: np.ndarray[Any, Any], stamp: int) -> Any:
    png = np.asarray(cv2.imencode(".png", pixels)[1]).ravel()
    return make(COMPRESSED, header=header(stamp), format="bayer_rggb8; png compressed bayer_rggb8", data=png)


def test_a_mosaic_of_colours_is_resolved_in_a_compressed_topic_too(tmp_path: Path) -> None:
    plain = scenes(lambda pixels, t: sent(pixels, t, "bayer_rggb8"), wall_info(0), wall_info(1))
    packed = scenes(mosaic, wall_info(0), wall_info(1), name="image_raw/compressed")
    images = []
    for name, messages in (("plain", plain), ("packed", packed)):
        with unpacked(bag(tmp_path / name, messages)) as (folder, _):
            images.append(cv2.imread(str(folder / "image_0" / "frame000000.pgm"), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(images[0], images[1])


@pytest.mark.parametrize(
    ("name", "raw", "note"),
    [
        ("image_raw", True, ""),
        ("image_rect_color", False, ""),
        ("image_rect", True, "they were rectified"),
        ("image", False, "rectified already"),
    ],
)
def test_rows_of_images_show_whether_they_are_rectified(tmp_path: Path, name: str, raw: bool, note: str) -> None:
    """Cameras with lenses unlike: what the topic says counts only where the rows do not tell."""
    lenses = [np.array([0.3, 0.0, 0.0, 0.0, 0.0]), np.array([-0.3, 0.0, 0.0, 0.0, 0.0])]
    infos = [wall_info(side, d=D) for side, D in enumerate(lenses)]
    K_wall = infos[0].k.reshape(3, 3)

    def told(pixels: np.ndarray[Any, Any], stamp: int) -> Any:
        sides.append(len(sides) % 2)
        if not raw:
            return sent(pixels, stamp)
        points = np.stack(np.meshgrid(np.arange(400.0), np.arange(300.0)), -1).reshape(-1, 1, 2)
        source = cv2.undistortPoints(points, K_wall, lenses[sides[-1]], P=K_wall).reshape(300, 400, 2)
        columns, rows = np.moveaxis(source.astype(np.float32), 2, 0)
        return sent(cv2.remap(pixels, columns, rows, cv2.INTER_LINEAR), stamp)

    sides: list[int] = []
    with unpacked(bag(tmp_path / "bag", scenes(told, *infos, name=name))) as (folder, notes):
        assert note in " ".join(notes)
        assert bool(note) == bool(notes)
        left, right = (cv2.imread(str(folder / f"image_{k}" / "frame000000.pgm"), cv2.IMREAD_GRAYSCALE) for k in (0, 1))
        assert rows_apart([(left, right)]) < 0.5  # type: ignore[list-item]  # grey images


def test_one_clock_times_all_messages_and_files_alone_are_a_bag(tmp_path: Path) -> None:
    """A message without a stamp: times are those of reception, for all; without metadata.yaml the files are read."""
    messages = [
        (topic, kind, stamp + 7 * 10**9, message if stamp != 1_100_000_000 else sent(scene(1, 0), 0))
        for topic, kind, stamp, message in scenes(sent, wall_info(0), wall_info(1))
    ]
    folder = bag(tmp_path / "bag", messages)
    (folder / "metadata.yaml").unlink()
    with unpacked(folder) as (found, notes):
        assert np.loadtxt(found / "times.txt") == pytest.approx([8.0, 8.1, 8.2])
        assert notes == ("messages without a time stamp: times are those of their reception",)


def test_images_that_are_sent_packed_too_count_once_and_those_alone_are_noted(tmp_path: Path) -> None:
    messages = scenes(sent, wall_info(0), wall_info(1))
    packed = scenes(mosaic, wall_info(0), wall_info(1), name="image_raw/compressed")
    del messages[5]  # the second right image
    with unpacked(bag(tmp_path / "bag", [*messages, *packed[2:]])) as (folder, notes):
        assert [frame.tick for frame in find_sequence(folder).frames] == [0, 200]
        assert notes == ("1 images have no partner",)


@pytest.mark.parametrize("tx", [(60.0, 0.0), (-5.0, -65.0)])
def test_the_difference_of_both_projections_is_the_baseline(tmp_path: Path, tx: tuple[float, float]) -> None:
    infos = [wall_info(side) for side in (0, 1)]
    for told, value in zip(infos, tx, strict=True):
        told.p[3] = value
    with unpacked(bag(tmp_path / "bag", scenes(sent, *infos))) as (folder, _):
        assert open_recording(folder).calibration.baseline == pytest.approx(0.2)


def test_exchanged_topics_are_taken_with_their_calibrations_or_without(tmp_path: Path) -> None:
    for name in ("both", "images"):
        messages = [
            (topic.replace("left", "x").replace("right", "left").replace("x", "right"), *row)
            for topic, *row in scenes(sent, wall_info(0), wall_info(1))
        ]
        if name == "images":
            infos_of = [(f"/cam/{s}/camera_info", INFO, 0, wall_info(k)) for s, k in (("left", 0), ("right", 1))]
            messages = [*infos_of, *(row for row in messages if row[1] != INFO)]
        with unpacked(bag(tmp_path / name, messages), Wanted(exchange=True)) as (folder, _):
            assert "1.995000000000e+02 -6.000000000000e+01 " in (folder / "calib.txt").read_text(encoding="utf-8")
            first = find_sequence(folder, exchange=True).frames[0]
            np.testing.assert_array_equal(cv2.imread(str(first.left), cv2.IMREAD_UNCHANGED), scene(0, 0))


def test_a_calibration_of_the_user_s_own_takes_the_place_of_camera_infos(tmp_path: Path) -> None:
    """The images stay as they were sent."""
    for name, messages in (("bare", [row for row in stereo() if row[1] != INFO]), ("raw", stereo())):
        with unpacked(bag(tmp_path / name, messages), Wanted(calibrated=True)) as (folder, notes):
            assert not (folder / "calib.txt").exists()
            assert notes == ()
            first = cv2.imread(str(folder / "image_1" / "frame000000.pgm"), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(first, picture(0, 1))


def header_of_png(width: int, height: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A black picture of any size: some bytes say how large it is, and a few thousand would be all of it."""
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(9)))]
    chunks = [struct.pack(">I", len(text)) + name + text + struct.pack(">I", zlib.crc32(name + text))
              for name, text in [*parts, (b"IEND", b"")]]  # fmt: skip
    return np.frombuffer(b"\x89PNG\r\n\x1a\n" + b"".join(chunks), np.uint8)


def webp() -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.asarray(cv2.imencode(".webp", picture(0, 0))[1]).ravel()


def bad_bags() -> Iterator[tuple[str, Messages, str, str]]:
    plain = stereo()
    both = {"left": 0, "right": 1}

    def without(part: str) -> Messages:
        return [row for row in plain if part not in row[0]]

    def with_info(**changes: Any) -> Messages:
        infos = [(f"/stereo/{name}/camera_info", INFO, 0, info(side, **changes)) for name, side in both.items()]
        return [*without("camera_info"), *infos]

    yield "no images", without("image_raw"), "", "it has none. Of a run of offtrack"
    yield "one camera", without("right"), "", "no topic of the right camera's images"
    yield "no calibration", without("camera_info"), "", "no calibration of the left camera"
    yield "two left", [*plain, ("/other/left/image_raw", IMAGE, 0, image(0, 0, 0))], "", "several topics of the left"
    yield "wrong topic", plain, "left=/stereo/left/image_ra", "is not in it; did you mean '/stereo/left/image_raw'?"
    yield "no image topic", plain, "left=/stereo/left/camera_info", "not images"
    yield "one topic for both", plain, "right=/stereo/left/image_raw", "one topic for both cameras"
    yield "unknown role", plain, "centre=/x", "expected left=/topic"
    yield "one frame", stereo(1), "", "1 images of the left camera; at least 2 are needed"
    yield "never together", stereo(8, right_late=5 * 10**9), "", "the cameras must be triggered together"
    yield "encoding", stereo(encoding="yuv999"), "", "encoding yuv999 is unknown"
    yield "cut off", stereo(data=np.zeros(9, np.uint8)), "", "it is cut off"
    yield "uncalibrated", with_info(k=np.zeros(9), p=np.zeros(12)), "", "calibrate the cameras"
    yield "nine coefficients", with_info(d=np.zeros(9)), "", "D has 9 coefficients"
    yield "unknown lens", with_info(distortion_model="mirror"), "", "distortion model mirror is unknown"
    yield "resized images", with_info(width=2 * WIDTH, height=2 * HEIGHT), "", "images of 128x96 px"
    yield "endless calibration", with_info(width=20_000, height=20_000), "", "at most 64 megapixels"
    for name, content, line in (("endless image", header_of_png(32_000, 32_000), "at most 64 megapixels"),
                                ("web image", webp(), "is corrupt or not an image")):  # fmt: skip
        packed = [
            (topic, COMPRESSED, stamp, make(COMPRESSED, header=header(stamp), format="png", data=content))
            if kind == IMAGE
            else (topic, kind, stamp, message)
            for topic, kind, stamp, message in plain
        ]
        yield name, packed, "", line
    yield "no baseline", with_info(p=np.column_stack([K, np.zeros(3)]).ravel()), "", "has no baseline"


@pytest.mark.parametrize(("messages", "topics", "line"), [pytest.param(*row[1:], id=row[0]) for row in bad_bags()])
def test_a_bad_bag_is_one_line(messages: Messages, topics: str, line: str, tmp_path: Path) -> None:
    one_line(["estimate", "off-tracking", str(bag(tmp_path / "bag", messages)), "--topics", topics], line, tmp_path)


def bad_files() -> Iterator[tuple[str, bytes, str]]:
    """Broken files, an MCAP file without the profile of ROS 2, and 4 GB of zeros, packed as a chunk and as a file."""
    read = "can not be read as a bag"
    yield from (("x.mcap", b"\x89MCAP", read), ("x.db3", b"none", read), ("x.bag", b"#ROSBAG V2.0\n\x00", read))
    viewers = b"\x89MCAP0\r\n\x01" + struct.pack("<QI", 12, 0) + bytes(20)
    yield "viewer.mcap", viewers, "export RUN --to rosbag2 --images DIR"
    yield "bomb.mcap", cast(bytes, other_thing("mcap bomb")[0]), "a message unpacks to more than 1000 MB"
    yield "bomb.db3.zstd", cast(bytes, other_thing("zstd bomb")[0]), "bomb.db3.zstd unpacks to more than 1013 MB"
    yield "bag/metadata.yaml", b"rosbag2_bagfile_information: [", "it holds no file of messages"


@pytest.mark.parametrize(("name", "content", "line"), [pytest.param(*row, id=row[0]) for row in bad_files()])
def test_a_broken_file_is_one_line(name: str, content: bytes, line: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    one_line(["estimate", "off-tracking", str(path if path.suffix != ".yaml" else path.parent)], line, tmp_path)


def test_a_full_disk_is_not_taken_for_a_broken_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bags, "write_images", lambda images: Path("/dev/full").write_text("x", encoding="utf-8"))
    full = f"{tempfile.gettempdir()}: No space left on device"
    one_line(["estimate", "off-tracking", str(bag(tmp_path / "bag", stereo()))], full, tmp_path)


def test_a_pipe_among_the_files_of_a_bag_is_no_file_of_it(tmp_path: Path) -> None:
    """The reader would wait for it for ever; it does so in a process of its own here, so that the test would end."""
    folder = bag(tmp_path / "bag", stereo())
    (file,) = folder.glob("*.db3")
    file.unlink()
    os.mkfifo(file)
    command = [sys.executable, "-m", "offtrack", "estimate", "off-tracking", str(folder), "--quiet"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60.0, check=False)
    assert answer.returncode == 2
    assert "can not be read as a bag" in answer.stderr
    assert len(answer.stderr.splitlines()) == 1


@pytest.mark.parametrize("place", ["run #1?", "100%41"])
@pytest.mark.parametrize("alone", [False, True])
def test_a_bag_may_lie_under_any_path(place: str, alone: bool, tmp_path: Path) -> None:
    """The database is opened by an address, in which these signs have a meaning."""
    (tmp_path / place).mkdir()
    folder = bag(tmp_path / "bag", stereo()).rename(tmp_path / place / "bag")
    (file,) = folder.glob("*.db3")
    (folder / f"{place}.db3").symlink_to(file)
    with unpacked(folder / f"{place}.db3" if alone else folder) as (found, _):
        assert len(list((found / "image_0").iterdir())) == 4


def one_line(arguments: list[str], line: str, folder: Path) -> None:
    answer = CliRunner().invoke(app, [*arguments, "--quiet", "--out", str(folder / "out")])
    assert answer.exit_code == 2, answer.output
    assert line in answer.stderr
    assert len(answer.stderr.splitlines()) == 1, answer.stderr
    assert not (folder / "out").exists()


def test_mcap_has_frames_bodies_paths_signals_and_images(tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="MCAP needs the extra 'export'")
    reader_of = pytest.importorskip("mcap.reader", reason="not installed: pip install mcap mcap-protobuf-support")
    decoder = pytest.importorskip("mcap_protobuf.decoder", reason="not installed: pip install mcap-protobuf-support")
    images = finished_run(tmp_path) / "images"
    answer = CliRunner().invoke(app, ["export", str(tmp_path), "--to", "mcap", "--images", str(images), "--quiet"])
    assert answer.exit_code == 0, answer.output
    found: dict[str, list[tuple[int, Any]]] = {}
    with (tmp_path / "signals.mcap").open("rb") as file:
        reader = reader_of.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for schema, channel, message in reader.iter_messages(topics=["/signals"]):
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
            assert channel.metadata["unit.value"] == "m"
            assert b'"v [m]"' in schema.data
        for _, channel, message, told in reader.iter_decoded_messages(topics=["/tf", "/scene", "/camera/left"]):
            found.setdefault(channel.topic, []).append((message.log_time, told))
    assert [len(found[topic]) for topic in ("/signals", "/tf", "/scene", "/camera/left")] == [100, 50, 1, 3]
    for k, (stamp, told) in enumerate(found["/signals"]):
        assert stamp == round(1e9 * 0.01 * k)
        assert told["v_y_semitrailer"] == pytest.approx(0.01 * k + 10.0, rel=1e-15)
        assert ("value" in told) == (k >= 50)
    transform = found["/tf"][1][1].transforms[1]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("W", "semitrailer")
    assert transform.translation.x == pytest.approx(0.02 + 6.0)
    turn = 2.0 * math.atan2(transform.rotation.z, transform.rotation.w)
    assert turn == pytest.approx(0.02 + 8.0 - 4.0 * math.pi)
    assert {entity.id for entity in found["/scene"][0][1].entities} >= {"tractor", "semitrailer", "path of the hitch"}
    assert found["/camera/left"][2][1].data == (images / "image_0" / "000002.png").read_bytes()
