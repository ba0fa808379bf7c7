"""Topics of ROS bags with stereo images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from vehicle.parameter_file import nearest
from vehicle.user_file import shown

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
