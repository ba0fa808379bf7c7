"""Calibration of a bag's cameras: CameraInfo with its binning and region of interest, and what rectifies raw images.

Whether images are raw is what their rows show; without a clear answer, what their topics say.
"""

from itertools import islice
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.exchange.recordings.calibrations.cameras import baseline
from offtrack.exchange.recordings.image_checks import RECTIFIED, rows_apart
from offtrack.exchange.recordings.layouts.bag_files import Bag
from offtrack.exchange.recordings.layouts.bag_images import grey_image
from offtrack.exchange.recordings.layouts.bag_topics import SIDES, StereoTopics
from offtrack.exchange.recordings.writers import projections_text
from scenarios.image_file import upper_bits, used_bits
from vehicle.foundation.user_file import MAX_PIXELS, shown
from vehicle.frames import FloatArray

_Maps: TypeAlias = tuple[Any, Any]  # from rectified to raw pixels
_PAIRS: Final = 3  # of the first images, that show whether they are rectified
_COEFFICIENTS: Final = (0, 4, 5, 8, 12, 14)  # of OpenCV's lenses
_LENSES: Final = ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "")


class _CameraInfo(NamedTuple):
    """Calibration of the images that a camera sends."""

    topic: str
    size: tuple[int, int]  # width, height [px]; (0, 0) if it does not say
    lens: str
    D: FloatArray
    K: FloatArray  # (3, 3)
    R: FloatArray  # (3, 3)
    P: FloatArray  # (3, 4)

    @property
    def straight(self) -> bool:
        """True if raw and rectified images are the same."""
        return not np.any(self.D) and np.allclose(self.R, np.eye(3)) and np.allclose(self.K, self.P[:, :3])

    def maps(self, size: tuple[int, int]) -> _Maps:
        """Maps from rectified to raw pixels of images of this width and height."""
        rectified_as = self.R, self.P[:, :3], size, cv2.CV_32FC1
        if self.lens in ("equidistant", "fisheye"):
            return cv2.fisheye.initUndistortRectifyMap(self.K, self.D[:4], *rectified_as)
        return cv2.initUndistortRectifyMap(self.K, self.D, *rectified_as)


class Rectification(NamedTuple):
    """How a bag's images become rectified ones."""

    calibration: str = ""  # of the rectified pair, as ``calib.txt`` has it
    maps: tuple[_Maps | None, ...] = (None, None)  # of the images of each side; None where they are rectified
    notes: tuple[str, ...] = ()  # on a surprise


def rectified(image: NDArray[Any], maps: _Maps | None) -> NDArray[Any]:
    """Image that maps rectify."""
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR)) if maps else image


def bag_cameras(bag: Bag, topics: StereoTopics, *, exchange: bool) -> Rectification:
    """Calibration of both cameras; with ``exchange`` the left topic has the images of the right one.

    Raises:
        ValueError: one line, if a CameraInfo is missing, can not be used, or belongs to images of another size.
    """
    infos = tuple(_info(bag, side, topic) for side, topic in zip(SIDES, topics.infos, strict=True))
    if exchange and baseline(infos[0].P, infos[1].P) < 0.0:  # else the calibrations are right, the images are not
        infos = infos[::-1]
    if baseline(infos[0].P, infos[1].P) <= 0.0:
        raise ValueError(
            f"{infos[1].topic}: P of the right camera has no baseline: P[3] is {infos[1].P[0, 3]:g} and must be less "
            f"than that of {infos[0].topic}, {infos[0].P[0, 3]:g}. It needs a stereo calibration; or are left and "
            "right exchanged? Then use --exchange"
        )
    calibration = projections_text(infos[0].P, infos[1].P)
    infos = infos[::-1] if exchange else infos
    first = [[grey_image(one.message, topic) for one in islice(bag.messages(topic), _PAIRS)] for topic in topics.images]
    for info, images in zip(infos, first, strict=True):
        for size in {image.shape[::-1] for image in images}:
            if size != info.size and info.size != (0, 0):
                raise ValueError(
                    f"{info.topic}: is the calibration of images of {info.size[0]}x{info.size[1]} px, by its binning "
                    f"and region of interest; those sent have {size[0]}x{size[1]} px. Scale it, or name the topic of "
                    "the images that it belongs to"
                )
    as_is = Rectification(calibration)
    if not all(first) or all(info.straight for info in infos):
        return as_is
    maps = tuple(info.maps(images[0].shape[::-1]) for info, images in zip(infos, first, strict=True))
    raw = Rectification(calibration, maps)
    pairs = [[upper_bits(image, used_bits(int(image.max()))) for image in pair] for pair in zip(*first, strict=False)]
    as_sent = rows_apart(pairs)
    straight = rows_apart([[rectified(*one) for one in zip(pair, maps, strict=True)] for pair in pairs])
    named = all("rect" in topic for topic in topics.images)
    if named and straight < RECTIFIED * as_sent:
        note = "topics say that images are rectified, their rows say that they are not: they were rectified"
        return raw._replace(notes=(note,))
    if not named and as_sent < RECTIFIED * straight:
        note = "images are rectified already, as their rows show: D and R of the CameraInfo are not used"
        return as_is._replace(notes=(note,))
    return as_is if named else raw


def _info(bag: Bag, side: str, topic: str) -> _CameraInfo:
    first = next(bag.messages(topic), None)
    if first is None:
        raise ValueError(
            f"no calibration of the {side} camera: it needs sensor_msgs/CameraInfo beside the images, or "
            f"--topics {side}_info=/topic, or --calibration"
        )
    return _camera_info(first.message, topic)


def _camera_info(message: Any, topic: str) -> _CameraInfo:
    """Calibration in a CameraInfo, whose K and P are those of the sensor: binning and region of interest scale them."""
    k, r, p, d = (_numbers(message, name) for name in "krpd")
    if k.size != 9 or p.size != 12 or not np.isfinite([*k, *p]).all() or k[0] <= 0.0 or p[0] <= 0.0:
        raise ValueError(f"{topic}: K or P is empty or not finite: calibrate the cameras")
    if d.size not in _COEFFICIENTS or not np.isfinite([*d, *r]).all():
        sizes = ", ".join(map(str, _COEFFICIENTS))
        raise ValueError(f"{topic}: D has {d.size} coefficients: it must have {sizes}, all finite, as must R")
    if message.distortion_model not in _LENSES:
        raise ValueError(
            f"{topic}: distortion model {shown(message.distortion_model)} is unknown: must be one of "
            f"{', '.join(filter(None, _LENSES))}; or rectify the images first"
        )
    binning = [max(1, int(getattr(message, f"binning_{axis}", 1))) for axis in "xy"]
    roi = message.roi
    size = [int(roi.width or message.width), int(roi.height or message.height)]
    region = np.array([[1.0, 0.0, -float(roi.x_offset)], [0.0, 1.0, -float(roi.y_offset)], [0.0, 0.0, 1.0]])
    seen = np.diag([1.0 / binning[0], 1.0 / binning[1], 1.0]) @ region
    if not 0 <= size[0] * size[1] <= MAX_PIXELS:
        most = f"an image must have at most {MAX_PIXELS // 10**6} megapixels"
        raise ValueError(f"{topic}: is the calibration of {size[0]}x{size[1]} px: {most}")
    return _CameraInfo(
        topic=topic,
        size=(size[0] // binning[0], size[1] // binning[1]),
        lens=message.distortion_model,
        D=d if d.size else np.zeros(5),
        K=seen @ k.reshape(3, 3),
        R=r.reshape(3, 3) if r.size == 9 and np.any(r) else np.eye(3),
        P=seen @ p.reshape(3, 4),
    )


def _numbers(message: Any, name: str) -> FloatArray:
    """A field of a CameraInfo; ROS 1 writes its name in upper case."""
    return np.array(getattr(message, name, getattr(message, name.upper(), ())), dtype=np.float64)
