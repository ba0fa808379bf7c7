"""ROS 2 bags and MCAP: runs read by other packages, and bags by ``offtrack estimate``; bags of others."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange.recordings.bags import parsed_topics, unpacked_bag
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log, Signal, write_log

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
    return make(INFO, header=header(0), binning_x=0, binning_y=0, roi=roi, **(fields | changes))


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
    with unpacked_bag(exported, {}) as folder:
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
    with unpacked_bag(folder, {}) as unpacked:
        for side in (0, 1):
            files = sorted((unpacked / f"image_{side}").iterdir())
            assert len(files) == 4
            expected = cv2.remap(picture(1, side), *maps, cv2.INTER_LINEAR)
            np.testing.assert_array_equal(cv2.imread(str(files[1]), cv2.IMREAD_UNCHANGED), expected)
        assert "P1: 60.0 0.0 31.5 -30.0" in (unpacked / "calib.txt").read_text(encoding="utf-8")


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
    with unpacked_bag(bag(tmp_path / "bag", told), chosen) as folder:
        for side in (0, 1):
            for file in (folder / f"image_{side}").iterdir():
                np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), picture(0, side))


def bad_bags() -> Iterator[tuple[str, Messages, str, str]]:
    plain = stereo()
    both = {"left": 0, "right": 1}

    def without(part: str) -> Messages:
        return [row for row in plain if part not in row[0]]

    def with_info(**changes: Any) -> Messages:
        infos = [(f"/stereo/{name}/camera_info", INFO, 0, info(side, **changes)) for name, side in both.items()]
        return [*without("camera_info"), *infos]

    yield "no images", without("image_raw"), "", "it has no images"
    yield "one camera", without("right"), "", "no topic of the right camera's images"
    yield "no calibration", without("camera_info"), "", "no calibration of the left camera"
    yield "two left", [*plain, ("/other/left/image_raw", IMAGE, 0, image(0, 0, 0))], "", "several topics of the left"
    yield "wrong topic", plain, "left=/stereo/left/image_ra", "bag; did you mean '/stereo/left/image_raw'?"
    yield "no image topic", plain, "left=/stereo/left/camera_info", "not images"
    yield "one topic for both", plain, "right=/stereo/left/image_raw", "one topic for both cameras"
    yield "unknown role", plain, "centre=/x", "expected left=/topic"
    yield "one frame", stereo(1), "", "1 images of the left camera; at least 2 are needed"
    yield "never together", stereo(8, right_late=5 * 10**9), "", "the cameras must be triggered together"
    yield "encoding", stereo(encoding="yuv999"), "", "encoding yuv999 is unknown"
    yield "cut off", stereo(data=np.zeros(9, np.uint8)), "", "it is cut off"
    yield "uncalibrated", with_info(k=np.zeros(9), p=np.zeros(12)), "", "calibrate the cameras"
    yield "unknown lens", with_info(distortion_model="mirror"), "", "distortion model mirror is unknown"
    yield "no baseline", with_info(p=np.column_stack([K, np.zeros(3)]).ravel()), "", "has no baseline"


@pytest.mark.parametrize(("messages", "topics", "line"), [pytest.param(*row[1:], id=row[0]) for row in bad_bags()])
def test_a_bad_bag_is_one_line(messages: Messages, topics: str, line: str, tmp_path: Path) -> None:
    one_line(["estimate", "off-tracking", str(bag(tmp_path / "bag", messages)), "--topics", topics], line, tmp_path)


def test_a_broken_file_is_one_line(tmp_path: Path) -> None:
    for name, content in (("x.mcap", b"\x89MCAP"), ("x.db3", b"none"), ("x.bag", b"#ROSBAG V2.0\n\x00")):
        (tmp_path / name).write_bytes(content)
        one_line(["estimate", "off-tracking", str(tmp_path / name)], "can not be read as a bag", tmp_path)
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: [", encoding="utf-8")
    one_line(["estimate", "off-tracking", str(tmp_path / "bag")], "can not be read as a bag", tmp_path)


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
