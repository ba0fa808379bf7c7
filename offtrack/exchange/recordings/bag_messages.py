"""ROS messages of cameras: images of every common encoding in grey, and CameraInfo with its binning and region.

Source: definitions of sensor_msgs/Image, CompressedImage and CameraInfo; names of encodings of image_encodings.hpp.
"""

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.image_file import pixels
from vehicle.foundation.user_file import MAX_PIXELS, shown
from vehicle.frames import FloatArray

_MONO: Final = ("mono8", "8UC1", "mono16", "16UC1")
_COLOURS: Final = {
    "rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY, "rgba8": cv2.COLOR_RGBA2GRAY, "bgra8": cv2.COLOR_BGRA2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY, "8UC4": cv2.COLOR_BGRA2GRAY, "rgb16": cv2.COLOR_RGB2GRAY, "bgr16": cv2.COLOR_BGR2GRAY,
    "rgba16": cv2.COLOR_RGBA2GRAY, "bgra16": cv2.COLOR_BGRA2GRAY,
}  # fmt: skip
_MOSAICS: Final = {
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY, "bayer_bggr": cv2.COLOR_BayerRG2GRAY, "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}  # fmt: skip  # OpenCV names a mosaic by its second row and column
_LUMINANCE: Final = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}  # first byte of it, of two a pixel
_ENCODINGS: Final = (*_MONO, *_COLOURS, *(name + bits for name in _MOSAICS for bits in ("8", "16")), *_LUMINANCE)
_LENSES: Final = ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "")


class CameraInfo(NamedTuple):
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

    def maps(self, size: tuple[int, int]) -> tuple[Any, Any]:
        """Maps from rectified to raw pixels of images of this width and height."""
        camera = self.K, self.D, self.R, self.P[:, :3], size, cv2.CV_32FC1
        if self.lens in ("equidistant", "fisheye"):
            return cv2.fisheye.initUndistortRectifyMap(self.K, self.D[:4], *camera[2:])
        return cv2.initUndistortRectifyMap(*camera)


def camera_info(message: Any, topic: str, where: str) -> CameraInfo:
    """Calibration in a CameraInfo, whose K and P are those of the sensor: binning and region of interest scale them.

    Raises:
        ValueError: one line, if it is empty, not finite, of an unknown lens, or of too large an image.
    """
    k, r, p, d = (_numbers(message, name) for name in "krpd")
    if k.size != 9 or p.size != 12 or not np.isfinite([*k, *p]).all() or k[0] <= 0.0 or p[0] <= 0.0:
        raise ValueError(f"{where}: {topic}: K or P is empty or not finite: calibrate the cameras")
    if message.distortion_model not in _LENSES:
        raise ValueError(
            f"{where}: {topic}: distortion model {shown(message.distortion_model)} is unknown: must be one of "
            f"{', '.join(filter(None, _LENSES))}; or rectify the images first"
        )
    binning = [max(1, int(getattr(message, f"binning_{axis}", 1))) for axis in "xy"]
    roi = message.roi
    size = [int(roi.width or message.width), int(roi.height or message.height)]
    region = np.array([[1.0, 0.0, -float(roi.x_offset)], [0.0, 1.0, -float(roi.y_offset)], [0.0, 0.0, 1.0]])
    seen = np.diag([1.0 / binning[0], 1.0 / binning[1], 1.0]) @ region
    if not 0 <= size[0] * size[1] <= MAX_PIXELS:
        most = f"an image must have at most {MAX_PIXELS // 10**6} megapixels"
        raise ValueError(f"{where}: {topic}: is the calibration of {size[0]}x{size[1]} px: {most}")
    return CameraInfo(
        topic=topic,
        size=(size[0] // binning[0], size[1] // binning[1]),
        lens=message.distortion_model,
        D=d,
        K=seen @ k.reshape(3, 3),
        R=r.reshape(3, 3) if r.size == 9 and np.any(r) else np.eye(3),
        P=seen @ p.reshape(3, 4),
    )


def _numbers(message: Any, name: str) -> FloatArray:
    """A field of a CameraInfo; ROS 1 writes its name in upper case."""
    return np.array(getattr(message, name, getattr(message, name.upper(), ())), dtype=np.float64)


def grey_image(message: Any, where: str) -> NDArray[Any]:
    """Image (height, width) in grey, of 8 or 16 bits as sent.

    Raises:
        ValueError: one line, if it can not be decoded.
    """
    if hasattr(message, "format"):
        return _compressed(message, where)
    encoding, height, width = message.encoding, int(message.height), int(message.width)
    if encoding not in _ENCODINGS:
        raise ValueError(f"{where}: encoding {shown(encoding)} is unknown: must be one of {', '.join(_ENCODINGS)}")
    deep = encoding.endswith("16") or encoding == "16UC1"
    channels = 2 if encoding in _LUMINANCE else _channels(encoding)
    pixel = channels * (2 if deep else 1)  # bytes
    step, data = int(message.step), np.frombuffer(bytes(message.data), np.uint8)
    if not (0 < width * height <= MAX_PIXELS and step >= width * pixel and data.size >= step * height):
        raise ValueError(f"{where}: an image of {width}x{height} px has {data.size} bytes, {step} a row: it is cut off")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, : width * pixel])
    if deep:
        rows = rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    if encoding in _LUMINANCE:
        return rows[:, _LUMINANCE[encoding] :: 2]
    return _grey(rows if channels == 1 else rows.reshape(height, width, channels), encoding)


def _channels(encoding: str) -> int:
    return 1 if encoding not in _COLOURS else 4 if "a" in encoding or encoding == "8UC4" else 3


def _grey(image: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Grey image of pixels in an encoding."""
    code = _COLOURS.get(encoding, _MOSAICS.get(encoding.rstrip("0123456789")))
    return image if code is None else np.asarray(cv2.cvtColor(image, code))


def _compressed(message: Any, where: str) -> NDArray[Any]:
    """Image of a CompressedImage, whose format names the encoding first if it is one of ROS."""
    image = pixels(bytes(message.data), f"{where}: an image of format {shown(str(message.format), 40)}")
    encoding = str(message.format).partition(";")[0].strip()
    if image.ndim == 2:
        return _grey(image, encoding if encoding.startswith("bayer_") else "mono8")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY))


def baseline(P_l: FloatArray, P_r: FloatArray) -> float:
    """Distance [m] of the right camera along the left one's x axis, by the difference of projections P (3, 4)."""
    return float(P_l[0, 3] / P_l[0, 0] - P_r[0, 3] / P_r[0, 0])
