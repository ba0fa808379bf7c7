"""ROS bags with stereo images as recordings: their topics, unpacked into a temporary folder.

Images are kept as they are if the bag holds the files of a recording of offtrack; else raw images are rectified as
their CameraInfo says, with K, D, R and P. Whether they are raw is what their rows show; without a clear answer, what
their topic says. Read by rosbags (extra ``export``), which needs no ROS.
"""

import json
import resource
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.exchange.recordings.bag_messages import CameraInfo, baseline, camera_info, grey_image
from offtrack.exchange.recordings.file_pairs import nearest_pairs
from offtrack.exchange.recordings.image_checks import rows_apart
from offtrack.exchange.recordings.stereo_sequence import Unpacked
from offtrack.exchange.recordings.writers import projections_text, write_images
from scenarios.extras import import_extra
from scenarios.image_file import upper_bits, used_bits
from scenarios.progress import Progress, no_progress
from vehicle.foundation.temporary import temporary_folder
from vehicle.foundation.user_file import MAX_FRAMES, nearest, shown

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


_OF_OWN: Final = "Of a run of offtrack, 'offtrack export RUN --to rosbag2 --images DIR' writes a bag with images"


def _found(side: str, images: Sequence[str], bag: str) -> str:
    found = [topic for topic in images if any(mark in topic.lower() for mark in _MARKS[side])]
    if len(found) == 1:
        return found[0]
    many = f"{bag}: {'several topics' if found else 'no topic'} of the {side} camera's images"
    if not images:
        raise ValueError(f"{many}: it has none. {_OF_OWN}")
    has = f"it has images in {', '.join(images[:8])}"
    raise ValueError(f"{many}; {has}. Choose by --topics left=/topic,right=/topic")


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
_ENDINGS: Final = (".mcap", ".db3", ".bag", ".zstd")
_UNPACKED: Final = 1_000_000_000  # of a message, or a chunk of them [bytes]
_UNPACKED_FILE: Final = 100  # times its size, and ``_UNPACKED``
_ZSTD: Final = b"\x28\xb5\x2f\xfd"  # begins what is packed; a message begins with a zero
_PAIRS: Final = 3  # of the first images, that show whether they are rectified
_CLEARLY: Final = 0.6  # times the difference of rows that shows which images are rectified


def is_bag(path: Path) -> bool:
    """True for the folder or the file of a bag."""
    return (path / "metadata.yaml").is_file() or bool(_files(path))


def _files(path: Path) -> list[Path]:
    """Files of messages: the path itself, or those in a folder."""
    inside = path.iterdir() if path.is_dir() else [path]
    return sorted(file for file in inside if file.suffix in _ENDINGS and file.is_file())


def _linked(bag: Path, place: Path, zstd: Any) -> list[Path]:
    """Links to the files of a bag under plain names, as a database is opened by an address; packed ones are unpacked.

    Metadata are not read: they repeat what the files hold, and may name others.
    """
    place.mkdir()
    links = []
    for k, file in enumerate(_files(bag)):
        links.append(place / f"{k}{file.with_suffix('').suffix if file.suffix == '.zstd' else file.suffix}")
        if file.suffix != ".zstd":
            links[-1].symlink_to(file.absolute())
            continue
        most = _UNPACKED + _UNPACKED_FILE * file.stat().st_size
        with zstd.open(file, "rb") as packed, links[-1].open("wb") as out:
            while part := packed.read(1_000_000):
                if out.write(part) and out.tell() > most:
                    raise ValueError(f"{bag}: {file.name} unpacks to more than {most / 1e6:.0f} MB")
    if not links:
        raise ValueError(f"{bag}: can not be read as a bag: it holds no file of messages")
    return links


def _zstd() -> Any:
    return import_extra("export", "bags need", "rosbags.rosbag2.reader").zstd


@contextmanager
def _limited_memory(bag: Path) -> Iterator[None]:
    """Let memory grow by at most ``_UNPACKED``: libraries unpack whatever a bag says that it holds."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        most = pages * resource.getpagesize() + _UNPACKED
        resource.setrlimit(resource.RLIMIT_AS, (min({most, *limits[:1]} - {resource.RLIM_INFINITY}), limits[1]))
    try:
        yield
    except MemoryError:
        raise ValueError(f"{bag}: a message unpacks to more than {_UNPACKED / 1e6:.0f} MB of memory") from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def _messages(reader: Any, connections: Sequence[Any], bag: Path) -> Iterator[tuple[Any, int, Any]]:
    """Messages with their connection and the time of their reception [ns]."""
    packed = reader.messages(connections)
    while True:
        with _limited_memory(bag):
            if (found := next(packed, None)) is None:
                return
            connection, received, data = found
            data = _zstd().decompress(data) if data[:4] == _ZSTD else data
            message = reader.deserialize(data, connection.msgtype)
        yield connection, received, message


@contextmanager
def unpacked_bag(
    bag: Path,
    topics: Mapping[str, str],
    progress: Progress = no_progress,
    *,
    exchange: bool = False,
    calibrated: bool = False,
) -> Iterator[Unpacked]:
    """Unpack a bag into a folder as ``offtrack estimate`` reads it, and remove the folder at the end.

    Args:
        bag: folder of a ROS 2 bag, or of its files alone, or a file ``.mcap``, ``.db3`` or ``.bag`` (ROS 1).
        topics: topics by role (``left``, ``right``, ``left_info``, ``right_info``); others are found by their names.
        progress: receives the number of messages read.
        exchange: takes the topics of the right camera for those of the left one.
        calibrated: the user gives the calibration: images stay as they are, and no CameraInfo is needed.

    Raises:
        ValueError: one line, if the package is missing, or the bag can not be read or used; errors that what is done
            with the folder raises name the bag.
    """
    highlevel = import_extra("export", f"{bag}: bags need", "rosbags.highlevel")
    with temporary_folder() as temporary:
        folder = temporary / (bag.stem if bag.is_file() else bag.resolve().name)
        folder.mkdir()
        place = temporary / "files of the bag"
        try:
            paths = _linked(bag, place, _zstd())
            reader = highlevel.AnyReader(paths, default_typestore=humble_types())
            with _limited_memory(bag):
                reader.open()
            with closing(reader):
                unpacked = _unpacked(reader, bag, folder, topics, progress, exchange=exchange, calibrated=calibrated)
        except (ValueError, KeyboardInterrupt, MemoryError):
            raise
        except Exception as error:  # of the reader, whatever the bag makes it stumble over
            line = " ".join(str(error).split()).replace(f"{place}/", "")
            if "Profile is not ros2" in line:
                raise ValueError(f"{bag}: its MCAP messages are those of a viewer, not of ROS 2. {_OF_OWN}") from None
            raise ValueError(
                f"{bag}: can not be read as a bag: {type(error).__name__}: {shown(line, 120)}. If it was cut off, try "
                "`ros2 bag reindex`, `mcap recover` or `rosbag reindex`"
            ) from None
        try:
            yield unpacked
        except ValueError as error:
            raise ValueError(str(error).replace(str(folder), str(bag))) from error


def humble_types() -> Any:
    """Messages of ROS 2 Humble."""
    typesys = import_extra("export", "bags need", "rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _unpacked(
    reader: Any,
    bag: Path,
    folder: Path,
    chosen: Mapping[str, str],
    progress: Progress,
    *,
    exchange: bool,
    calibrated: bool,
) -> Unpacked:
    kinds = {connection.topic: connection.msgtype for connection in reader.connections}
    topics = stereo_topics(kinds, chosen, str(bag))
    if exchange:
        topics = StereoTopics(topics.right, topics.left, topics.right_info, topics.left_info)
    if topics.left == topics.right:
        raise ValueError(f"{bag}: --topics names one topic for both cameras: {topics.left}")
    files = _recording_files(reader, kinds, bag)
    maps: dict[str, tuple[Any, Any]] = {}
    notes: list[str] = []
    if not calibrated and "calib.txt" not in files and "rig.toml" not in files:
        infos = _infos(reader, topics, bag)
        if exchange and baseline(infos[0].P, infos[1].P) < 0.0:  # the calibrations were right, the images were not
            infos = infos[::-1]
        files["calib.txt"] = _calibration(infos, bag)
        maps, notes = _rectifying(reader, topics, infos, bag)
    stamps, of_stamps = _write_images(reader, topics, folder, maps, bag, progress)
    left, right = (_increasing(stamps[side], side, bag) for side in SIDES)
    pairs = nearest_pairs(left.stamps, right.stamps, 1e-6, str(bag))
    _number(folder / _FOLDERS["left"], left.images[pairs.left])
    _number(folder / _FOLDERS["right"], right.images[pairs.right])
    times = (1e-9 * left.stamps[pairs.left]).tolist()
    (folder / "times.txt").write_text("".join(f"{time:.9f}\n" for time in times), encoding="utf-8")
    for name, text in files.items():
        if name != "poses.txt" or len(text.splitlines()) == len(times):
            (folder / name).write_text(text, encoding="utf-8")
    return Unpacked(folder, (*notes, *of_stamps))


class _Images(NamedTuple):
    """Images of a camera in the order of their stamps."""

    stamps: NDArray[np.int64]  # [ns]
    images: NDArray[np.intp]  # their numbers in the bag


def _increasing(stamps: Sequence[int], side: str, bag: Path) -> _Images:
    """Images with a stamp of their own."""
    found = _Images(*np.unique(np.array(stamps, dtype=np.int64), return_index=True))
    if found.stamps.size < 2:
        raise ValueError(f"{bag}: {found.stamps.size} images of the {side} camera; at least 2 are needed")
    return found


def _recording_files(reader: Any, kinds: Mapping[str, str], bag: Path) -> dict[str, str]:
    """Files of a recording of offtrack that the bag holds."""
    if kinds.get(RECORDING) != "std_msgs/msg/String":
        return {}
    message = next(_messages(reader, [c for c in reader.connections if c.topic == RECORDING], bag), None)
    files = json.loads(message[2].data) if message else {}
    return {name: str(files[name]) for name in _FILES if name in files}


def _infos(reader: Any, topics: StereoTopics, bag: Path) -> tuple[CameraInfo, ...]:
    """Calibrations of the left and the right camera."""
    infos = []
    for side, topic in zip(SIDES, (topics.left_info, topics.right_info), strict=True):
        found = [c for c in reader.connections if topic and c.topic == topic]
        message = next(_messages(reader, found, bag), None) if found else None
        if message is None:
            raise ValueError(
                f"{bag}: no calibration of the {side} camera: it needs sensor_msgs/CameraInfo beside the images, or "
                f"--topics {side}_info=/topic, or --calibration"
            )
        infos.append(camera_info(message[2], topic, str(bag)))
    return tuple(infos)


def _calibration(infos: Sequence[CameraInfo], bag: Path) -> str:
    """Text of a ``calib.txt``."""
    if baseline(infos[0].P, infos[1].P) <= 0.0:
        raise ValueError(
            f"{bag}: {infos[1].topic}: P of the right camera has no baseline: P[3] is {infos[1].P[0, 3]:g} and must be "
            f"less than that of {infos[0].topic}, {infos[0].P[0, 3]:g}. It needs a stereo calibration; or are left and "
            "right exchanged? Then use --exchange"
        )
    return projections_text(infos[0].P, infos[1].P)


def _rectifying(
    reader: Any, topics: StereoTopics, infos: Sequence[CameraInfo], bag: Path
) -> tuple[dict[str, tuple[Any, Any]], list[str]]:
    """Maps that rectify the images of each side, empty where they are rectified; and a note on a surprise."""
    first = [_first_images(reader, topic, bag) for topic in topics[:2]]
    for info, images in zip(infos, first, strict=True):
        for size in {image.shape[::-1] for image in images}:
            if size != info.size and info.size != (0, 0):
                raise ValueError(
                    f"{bag}: {info.topic}: is the calibration of images of {info.size[0]}x{info.size[1]} px, by its "
                    f"binning and region of interest; those sent have {size[0]}x{size[1]} px. Scale it, or name the "
                    "topic of the images that it belongs to"
                )
    if not all(first) or all(info.straight for info in infos):
        return {}, []
    maps = {side: info.maps(images[0].shape[::-1]) for side, info, images in zip(SIDES, infos, first, strict=True)}
    shown_as = [[upper_bits(image, used_bits(int(image.max()))) for image in images] for images in first]
    raw = list(zip(*shown_as, strict=False))
    straight = [tuple(_remapped(image, maps[side]) for side, image in zip(SIDES, pair, strict=True)) for pair in raw]
    as_sent, rectified = rows_apart(raw), rows_apart(straight)
    named = all("rect" in topic for topic in topics[:2])
    if named and rectified < _CLEARLY * as_sent:
        return maps, ["topics say that images are rectified, their rows say that they are not: they were rectified"]
    if not named and as_sent < _CLEARLY * rectified:
        return {}, ["images are rectified already, as their rows show: D and R of the CameraInfo are not used"]
    return ({}, []) if named else (maps, [])


def _first_images(reader: Any, topic: str, bag: Path) -> list[NDArray[Any]]:
    connections = [c for c in reader.connections if c.topic == topic and c.msgtype in IMAGES]
    messages = islice(_messages(reader, connections, bag), _PAIRS)
    return [grey_image(message, f"{bag}: {topic}") for _, _, message in messages]


def _remapped(image: NDArray[Any], maps: tuple[Any, Any]) -> NDArray[Any]:
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))


def _write_images(
    reader: Any, topics: StereoTopics, folder: Path, maps: Mapping[str, tuple[Any, Any]], bag: Path, progress: Progress
) -> tuple[dict[str, list[int]], list[str]]:
    """Write every image under its number; return the stamps [ns], of one clock, and a note on it."""
    sides = {topics.left: "left", topics.right: "right"}
    stamps: dict[str, list[tuple[int, int]]] = {side: [] for side in SIDES}
    for name in _FOLDERS.values():
        (folder / name).mkdir()
    connections = [c for c in reader.connections if c.topic in sides and c.msgtype in IMAGES]
    total = sum(c.msgcount for c in connections)
    for done, (connection, received, message) in enumerate(_messages(reader, connections, bag), start=1):
        side = sides[connection.topic]
        at = message.header.stamp
        if len(stamps[side]) >= MAX_FRAMES:
            raise ValueError(f"{bag}: more than {MAX_FRAMES} images of the {side} camera: cut the bag")
        image = grey_image(message, f"{bag}: {connection.topic}")
        if side in maps:
            image = _remapped(image, maps[side])
        write_images({folder / _FOLDERS[side] / f"{len(stamps[side])}.pgm": image})
        stamps[side].append((at.sec * 1_000_000_000 + at.nanosec, received))
        progress(done, max(total, done), "unpacking")
    sent = all(stamp for side in SIDES for stamp, _ in stamps[side])
    clock = 0 if sent else 1
    note = [] if sent else ["messages without a time stamp: times are those of their reception"]
    return {side: [both[clock] for both in stamps[side]] for side in SIDES}, note


def _number(folder: Path, kept: NDArray[np.intp]) -> None:
    """Number the images anew; remove the others."""
    for k, number in enumerate(kept):
        (folder / f"{number}.pgm").rename(folder / f"frame{k:06d}.pgm")
    for path in folder.iterdir():
        if not path.name.startswith("frame"):
            path.unlink()
