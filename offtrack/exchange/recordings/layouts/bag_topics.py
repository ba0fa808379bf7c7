"""Topics of a stereo pair in a bag: as the user names them, else by their names."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from offtrack.exchange.recordings.layouts.bag_files import OF_OWN
from vehicle.foundation.user_file import nearest, shown

SIDES: Final = ("left", "right")
_IMAGES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_PACKED: Final = "/compressed"  # the same images as of the topic without it
_INFO: Final = "sensor_msgs/msg/CameraInfo"
_KEYS: Final = ("left", "right", "left_info", "right_info")
_MARKS: Final = {
    "left": ("left", "image_0", "image_2", "cam0", "infra1"),
    "right": ("right", "image_1", "image_3", "cam1", "infra2"),
}


class StereoTopics(NamedTuple):
    """Images and calibrations of the left and the right camera; calibrations are empty if there are none."""

    images: tuple[str, ...]
    infos: tuple[str, ...]


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


def stereo_topics(kinds: Mapping[str, str], chosen: Mapping[str, str]) -> StereoTopics:
    """Topics of the images and their calibrations, as ``chosen``, else by their names; ``kinds`` are all by topic.

    Raises:
        ValueError: one line, if a chosen topic is missing, or there is not exactly one topic for each side.
    """
    for key, topic in chosen.items():
        if topic not in kinds:
            raise ValueError(f"--topics {key}={shown(topic)}: is not in it{nearest(topic, kinds)}")
    named = sorted(topic for topic, kind in kinds.items() if kind in _IMAGES)
    named = [topic for topic in named if topic.removesuffix(_PACKED) not in named or not topic.endswith(_PACKED)]
    images = tuple(chosen.get(side) or _found(side, named) for side in SIDES)
    for side, topic in zip(SIDES, images, strict=True):
        if kinds[topic] not in _IMAGES:
            raise ValueError(f"--topics {side}={topic}: has messages {kinds[topic]}, not images")
    if images[0] == images[1]:
        raise ValueError(f"--topics names one topic for both cameras: {images[0]}")
    infos = (chosen.get(f"{side}_info") or _info_of(topic, kinds) for side, topic in zip(SIDES, images, strict=True))
    return StereoTopics(images, tuple(infos))


def _found(side: str, images: Sequence[str]) -> str:
    found = [topic for topic in images if any(mark in topic.lower() for mark in _MARKS[side])]
    if len(found) == 1:
        return found[0]
    many = f"{'several topics' if found else 'no topic'} of the {side} camera's images"
    if not images:
        raise ValueError(f"{many}: it has none. {OF_OWN}")
    has = f"it has images in {', '.join(images[:8])}"
    raise ValueError(f"{many}; {has}. Choose by --topics left=/topic,right=/topic")


def _info_of(topic: str, kinds: Mapping[str, str]) -> str:
    """The calibration beside an image: ``…/camera_info`` in the same namespace, or in the one above."""
    parts = topic.split("/")
    places = ("/".join([*parts[:end], "camera_info"]) for end in (-1, -2))
    return next((info for info in places if kinds.get(info) == _INFO), "")
