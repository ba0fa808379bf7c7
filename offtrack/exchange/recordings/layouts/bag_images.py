"""ROS messages with images, of every common encoding, in grey.

Source: definitions of sensor_msgs/Image and CompressedImage; names of encodings of image_encodings.hpp.
"""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.image_file import pixels
from vehicle.foundation.user_file import MAX_PIXELS, shown

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
