"""ROS bags with stereo images as recordings: their topics, unpacked into a temporary folder.

Images are kept as they are if the bag holds the files of a recording of offtrack; else raw images are rectified as
their CameraInfo says, with K, D, R and P. Read by rosbags (extra ``export``), which needs no ROS.
"""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from offtrack.exchange.recordings.file_pairs import nearest_pairs
from scenarios.extras import import_extra
from scenarios.progress import Progress, no_progress
from sensors.messages import GreyImage
from vehicle.foundation.user_file import MAX_FRAMES, MAX_PIXELS, nearest, shown
from vehicle.frames import FloatArray

SIDES: Final = ("left", "right")
FRAMES: Final = {"left": "camera_left", "right": "camera_right"}
RECORDING: Final = "/offtrack/recording"  # files of a recording of offtrack: calibration, mounting, true poses
IMAGES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO: Final = "sensor_msgs/msg/CameraInfo"
_KEYS: Final = ("left", "right", "left_info", "right_info")
_MARKS: Final = {
    "left": ("left", "image_0", "image_2", "cam0", "infra1"),
    "right": ("right", "image_1", "image_3", "cam1", "infra2"),
}


class StereoTopics(NamedTuple):
    """Topics of a stereo pair; calibrations are empty if there are none."""

    left: str
    right: str
    left_info: str
    right_info: str


def parsed_topics(text: str) -> dict[str, str]:
    """Topics by their role, from ``left=/a/image,right=/b/image``.

    Raises:
        ValueError: one line, for anything else.
    """
    topics = dict[str, str]()
    for part in filter(None, (part.strip() for part in text.split(","))):
        key, sign, topic = part.partition("=")
        if not sign or key not in _KEYS or not topic.strip() or key in topics:
            raise ValueError(
                f"--topics {shown(text)}: expected {', '.join(f'{key}=/topic' for key in _KEYS)}, each at most once"
            )
        topics[key] = topic.strip()
    return topics


def stereo_topics(kinds: Mapping[str, str], chosen: Mapping[str, str], bag: str) -> StereoTopics:
    """Topics of the images and their calibrations, as ``chosen``, else by their names; ``kinds`` are all by topic.

    Raises:
        ValueError: one line, if a chosen topic is missing, or there is not exactly one topic for each side.
    """
    images = sorted(topic for topic, kind in kinds.items() if kind in IMAGES)
    for key, topic in chosen.items():
        if topic not in kinds:
            raise ValueError(f"--topics {key}={shown(topic)}: is not in {bag}{nearest(topic, kinds)}")
    left, right = (chosen.get(side) or _found(side, images, bag) for side in SIDES)
    for side, topic in (("left", left), ("right", right)):
        if kinds[topic] not in IMAGES:
            raise ValueError(f"--topics {side}={topic}: has messages {kinds[topic]}, not images")
    infos = [chosen.get(f"{side}_info") or _info_of(topic, kinds) for side, topic in (("left", left), ("right", right))]
    return StereoTopics(left, right, *infos)


def _found(side: str, images: Sequence[str], bag: str) -> str:
    found = [topic for topic in images if any(mark in topic.lower() for mark in _MARKS[side])]
    if len(found) == 1:
        return found[0]
    has = f"it has images in {', '.join(images[:8])}" if images else "it has no images"
    many = "several topics of" if found else "no topic of"
    raise ValueError(f"{bag}: {many} the {side} camera's images; {has}. Choose by --topics left=/topic,right=/topic")


def _info_of(topic: str, kinds: Mapping[str, str]) -> str:
    """The calibration beside an image: ``…/camera_info`` in the same namespace, or in the one above."""
    parts = topic.split("/")
    for end in (-1, -2):
        info = "/".join([*parts[:end], "camera_info"])
        if kinds.get(info) == INFO:
            return info
    return ""


_FILES: Final = ("calib.txt", "rig.toml", "poses.txt")  # of a recording of offtrack
_FOLDERS: Final = {"left": "image_0", "right": "image_1"}
_ENDINGS: Final = (".mcap", ".db3", ".bag")
_GREY: Final = {
    "rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY, "rgba8": cv2.COLOR_RGBA2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY, "bayer_rggb8": cv2.COLOR_BayerBG2GRAY, "bayer_bggr8": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg8": cv2.COLOR_BayerGR2GRAY, "bayer_grbg8": cv2.COLOR_BayerGB2GRAY,
}  # fmt: skip
_MONO: Final = ("mono8", "8UC1")
_MONO16: Final = ("mono16", "16UC1")
_LENSES: Final = ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "")


class _Info(NamedTuple):
    """Contents of a CameraInfo."""

    size: tuple[int, int]
    lens: str
    D: FloatArray
    K: FloatArray  # (3, 3)
    R: FloatArray  # (3, 3)
    P: FloatArray  # (3, 4)


def is_bag(path: Path) -> bool:
    """True for the folder or the file of a bag."""
    return (path / "metadata.yaml").is_file() or (path.suffix in _ENDINGS and path.is_file())


@contextmanager
def unpacked_bag(bag: Path, topics: Mapping[str, str], progress: Progress = no_progress) -> Iterator[Path]:
    """Unpack a bag into a folder as ``offtrack estimate`` reads it, and remove the folder at the end.

    Args:
        bag: folder of a ROS 2 bag, or a file ``.mcap``, ``.db3`` or ``.bag`` (ROS 1).
        topics: topics by role (``left``, ``right``, ``left_info``, ``right_info``); others are found by their names.
        progress: receives the number of messages read.

    Raises:
        ValueError: one line, if the package is missing, or the bag can not be read or used.
    """
    highlevel = import_extra("export", f"{bag}: bags need", "rosbags.highlevel")
    with tempfile.TemporaryDirectory(prefix="offtrack-bag-") as temporary:
        folder = Path(temporary) / (bag.stem if bag.is_file() else bag.resolve().name)
        folder.mkdir()
        try:
            _unpack(highlevel.AnyReader, bag, folder, topics, progress)
        except (ValueError, KeyboardInterrupt, MemoryError):
            raise
        except Exception as error:  # of the reader, whatever the bag makes it stumble over
            line = " ".join(str(error).split())
            raise ValueError(f"{bag}: can not be read as a bag: {type(error).__name__}: {shown(line, 120)}") from None
        yield folder


def humble_types() -> Any:
    """Messages of ROS 2 Humble."""
    typesys = import_extra("export", "bags need", "rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _unpack(reader_of: Any, bag: Path, folder: Path, chosen: Mapping[str, str], progress: Progress) -> None:
    with reader_of([bag], default_typestore=humble_types()) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        topics = stereo_topics(kinds, chosen, str(bag))
        files = _recording_files(reader, kinds)
        infos = {} if "calib.txt" in files or "rig.toml" in files else _infos(reader, topics, bag)
        maps = {side: _rectifying(info) for side, info in infos.items() if not _is_rectified(info, topics, side)}
        stamps = _write_images(reader, topics, folder, maps, bag, progress)
    pairs = _pairs(stamps, bag)
    for side, column in zip(SIDES, zip(*pairs, strict=True), strict=True):
        _number(folder / _FOLDERS[side], column)
    (folder / "times.txt").write_text("".join(f"{1e-9 * left:.9f}\n" for left, _ in pairs), encoding="utf-8")
    if infos:
        files["calib.txt"] = _calibration_text(infos, bag)
    for name, text in files.items():
        if name != "poses.txt" or len(text.splitlines()) == len(pairs):
            (folder / name).write_text(text, encoding="utf-8")


def _recording_files(reader: Any, kinds: Mapping[str, str]) -> dict[str, str]:
    """Files of a recording of offtrack that the bag holds."""
    if kinds.get(RECORDING) != "std_msgs/msg/String":
        return {}
    for connection, _, data in reader.messages([c for c in reader.connections if c.topic == RECORDING]):
        files = json.loads(reader.deserialize(data, connection.msgtype).data)
        return {name: str(files[name]) for name in _FILES if name in files}
    return {}


def _infos(reader: Any, topics: StereoTopics, bag: Path) -> dict[str, _Info]:
    infos = {}
    for side, topic in zip(SIDES, (topics.left_info, topics.right_info), strict=True):
        found = [c for c in reader.connections if topic and c.topic == topic]
        message = next(iter(reader.messages(found)), None) if found else None
        if message is None:
            raise ValueError(
                f"{bag}: no calibration of the {side} camera: it needs sensor_msgs/CameraInfo beside the images, or "
                f"--topics {side}_info=/topic, or --calibration"
            )
        info = reader.deserialize(message[2], message[0].msgtype)
        k, r, p, d = (_numbers(info, name) for name in "krpd")
        if k.size != 9 or p.size != 12 or not np.isfinite([*k, *p]).all() or k[0] <= 0.0 or p[0] <= 0.0:
            raise ValueError(
                f"{bag}: {topic}: K or P of the {side} camera is empty or not finite: calibrate the cameras"
            )
        if info.distortion_model not in _LENSES:
            raise ValueError(
                f"{bag}: {topic}: distortion model {shown(info.distortion_model)} is unknown: must be one of "
                f"{', '.join(filter(None, _LENSES))}; or rectify the images first"
            )
        R = r.reshape(3, 3) if r.size == 9 and np.any(r) else np.eye(3)
        size = int(info.width), int(info.height)
        infos[side] = _Info(size, info.distortion_model, d, k.reshape(3, 3), R, p.reshape(3, 4))
    return infos


def _numbers(info: Any, name: str) -> FloatArray:
    """A field of a CameraInfo; ROS 1 writes its name in upper case."""
    return np.array(getattr(info, name, getattr(info, name.upper(), ())), dtype=np.float64)


def _is_rectified(info: _Info, topics: StereoTopics, side: str) -> bool:
    plain = not np.any(info.D) and np.allclose(info.R, np.eye(3)) and np.allclose(info.K, info.P[:, :3])
    return plain or "rect" in (topics.left if side == "left" else topics.right).rpartition("/")[2]


def _rectifying(info: _Info) -> tuple[Any, Any]:
    """Maps from rectified to raw pixels."""
    if info.lens in ("equidistant", "fisheye"):
        return cv2.fisheye.initUndistortRectifyMap(info.K, info.D[:4], info.R, info.P[:, :3], info.size, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(info.K, info.D, info.R, info.P[:, :3], info.size, cv2.CV_32FC1)


def _write_images(
    reader: Any, topics: StereoTopics, folder: Path, maps: Mapping[str, tuple[Any, Any]], bag: Path, progress: Progress
) -> dict[str, list[int]]:
    """Write every image under its time stamp; return the stamps [ns]."""
    sides = {topics.left: "left", topics.right: "right"}
    if len(sides) < 2:
        raise ValueError(f"{bag}: --topics names one topic for both cameras: {topics.left}")
    stamps: dict[str, list[int]] = {side: [] for side in SIDES}
    for name in _FOLDERS.values():
        (folder / name).mkdir()
    connections = [c for c in reader.connections if c.topic in sides and c.msgtype in IMAGES]
    total = sum(c.msgcount for c in connections)
    for done, (connection, time, data) in enumerate(reader.messages(connections), start=1):
        side = sides[connection.topic]
        message = reader.deserialize(data, connection.msgtype)
        at = message.header.stamp
        stamp = at.sec * 1_000_000_000 + at.nanosec or time
        if len(stamps[side]) >= MAX_FRAMES:
            raise ValueError(f"{bag}: more than {MAX_FRAMES} images of the {side} camera: cut the bag")
        image = _image(message, f"{bag}: {connection.topic}")
        if side in maps:
            image = np.asarray(cv2.remap(image, *maps[side], cv2.INTER_LINEAR), dtype=np.uint8)
        cv2.imwrite(str(folder / _FOLDERS[side] / f"{stamp}.pgm"), image)
        stamps[side].append(stamp)
        progress(done, max(total, done), "unpacking")
    return stamps


def _image(message: Any, where: str) -> GreyImage:
    """The image in grey."""
    if hasattr(message, "format"):
        image = cv2.imdecode(np.frombuffer(bytes(message.data), np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ValueError(f"{where}: a compressed image can not be decoded (format {shown(str(message.format))})")
        return np.asarray(image, dtype=np.uint8)
    encoding, height, width = message.encoding, int(message.height), int(message.width)
    channels = (
        2 if encoding in _MONO16 else 1 if encoding in _MONO or encoding.startswith("bayer") else 3 + ("a8" in encoding)
    )
    if encoding not in (*_MONO, *_MONO16, *_GREY):
        raise ValueError(
            f"{where}: encoding {shown(encoding)} is unknown: must be one of {', '.join((*_MONO, *_MONO16, *_GREY))}"
        )
    step, data = int(message.step), np.frombuffer(bytes(message.data), np.uint8)
    if not (0 < width * height <= MAX_PIXELS and step >= width * channels and data.size >= step * height):
        raise ValueError(f"{where}: an image of {width}x{height} px has {data.size} bytes, {step} a row: it is cut off")
    rows = data[: step * height].reshape(height, step)[:, : width * channels]
    if encoding in _MONO16:
        deep = np.ascontiguousarray(rows).view(">u2" if message.is_bigendian else "<u2")
        return np.asarray(deep >> 8, dtype=np.uint8)
    if encoding in _MONO:
        return np.ascontiguousarray(rows)
    colours = np.ascontiguousarray(rows).reshape((height, width) if channels == 1 else (height, width, channels))
    return np.asarray(cv2.cvtColor(colours, _GREY[encoding]), dtype=np.uint8)


def _pairs(stamps: Mapping[str, list[int]], bag: Path) -> list[tuple[int, int]]:
    """Left and right stamps of every frame: to each left image the nearest right one."""
    left, right = (np.unique(np.array(stamps[side], dtype=np.int64)) for side in SIDES)
    for side, found in zip(SIDES, (left, right), strict=True):
        if found.size < 2:
            raise ValueError(f"{bag}: {found.size} images of the {side} camera; at least 2 are needed")
    pairs = nearest_pairs(left, right, 1e-6, str(bag))
    return list(zip(left[pairs.left].tolist(), right[pairs.right].tolist(), strict=True))


def _number(folder: Path, stamps: tuple[int, ...]) -> None:
    """Number the images with these stamps; remove the others."""
    for k, stamp in enumerate(stamps):
        (folder / f"{stamp}.pgm").rename(folder / f"frame{k:06d}.pgm")
    for path in folder.iterdir():
        if not path.name.startswith("frame"):
            path.unlink()


def _calibration_text(infos: Mapping[str, _Info], bag: Path) -> str:
    """Projections of the rectified cameras as in KITTI's calib.txt."""
    if infos["right"].P[0, 3] >= 0.0:
        raise ValueError(
            f"{bag}: P of the right camera has no baseline (P[3] = {infos['right'].P[0, 3]:g}, must be below 0): it "
            "needs a stereo calibration; or are left and right exchanged?"
        )
    rows = (f"P{k}: {' '.join(repr(float(v)) for v in infos[side].P.ravel())}" for k, side in enumerate(SIDES))
    return "\n".join(rows) + "\n"
