"""Images that a user gives: photograph and bitmap formats only, their size checked before they are decoded.

And the pictures that a run keeps for its report.
"""

import io
import os
import threading
import zlib
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL.BmpImagePlugin import BmpImageFile
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.PpmImagePlugin import PpmImageFile
from PIL.TiffImagePlugin import TiffImageFile

from sensors.messages import ColourImage, GreyImage
from vehicle.foundation.user_file import MAX_PIXELS, FileKind, read_bytes

# First bytes of a file, and the reader of its format. Pillow's other readers never see a file: one starts Ghostscript.
_FORMATS: Final = (
    (b"\x89PNG\r\n\x1a\n", PngImageFile),
    (b"\xff\xd8\xff", JpegImageFile),
    (b"BM", BmpImageFile),
    (b"II", TiffImageFile),
    (b"MM", TiffImageFile),
    (b"P4", PpmImageFile),
    (b"P5", PpmImageFile),
    (b"P6", PpmImageFile),
)
_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff")
_PLAIN: Final = (b"P1", b"P2", b"P3")  # numbers as text, which Pillow reads at a megapixel per second
_STDERR: Final = threading.Lock()  # images are read in several threads


def images_in(folder: Path) -> list[Path]:
    """Image files of a folder in the order of their names; hidden ones, as of another system's disk, are left out.

    Raises:
        ValueError: one line, if there are none.
    """
    named = (path for path in folder.iterdir() if not path.name.startswith("."))
    files = sorted(path for path in named if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise ValueError(f"{folder} contains no images ({', '.join(_SUFFIXES)})")
    return files


def pixel_size(path: Path) -> tuple[int, int]:
    """Width and height [px], from the header.

    Raises:
        ValueError: as ``read_grey``, except for damage behind the header.
    """
    return _opened(path, _content(path)).size


def read_grey(path: Path, bits: int = 16) -> GreyImage:
    """Read an image (height, width) as 8-bit grey levels: the luminance of colours, the upper 8 of ``bits`` of 16.

    Raises:
        ValueError: one line, if the file is missing, is not a complete image, or has more than ``MAX_PIXELS``.
    """
    content = _content(path)
    if _is_whole_grey_png(content):  # OpenCV takes three quarters of Pillow's time
        return _by_opencv(path, content, cv2.IMREAD_GRAYSCALE)
    image = _decoded(path, content)
    if image.mode.startswith("I"):  # 16 bits
        return upper_bits(np.asarray(image, dtype=np.uint32), bits)
    return np.asarray(image if image.mode == "L" else image.convert("L"))


def upper_bits(image: NDArray[Any], bits: int) -> GreyImage:
    """The upper 8 of the ``bits`` that an image uses; brighter pixels are white."""
    return np.asarray(np.minimum(image >> (bits - 8), 255), dtype=np.uint8)


def used_bits(largest: int) -> int:
    """Bits that a camera's analogue-to-digital converter has, by the largest of many grey levels."""
    return next(bits for bits in (8, 10, 12, 14, 16) if largest < 2**bits)


def grey_bits(paths: Iterable[Path]) -> int:
    """Bits of 16 that images use; unreadable ones and those of 8 bits say nothing.

    A 12-bit camera fills the lower 12: their upper 8 are the picture.
    """
    largest = []
    for path in paths:
        try:
            image = _opened(path, _content(path))
            if image.mode.startswith("I"):
                largest.append(int(np.asarray(_decoded(path, _content(path)), dtype=np.uint32).max()))
        except ValueError:
            continue
    return used_bits(max(largest)) if largest else 16


def read_grey_upright(path: Path) -> GreyImage:
    """Read an image as ``read_grey``, turned as the EXIF data of a photograph say; grey levels are those of OpenCV.

    Raises:
        ValueError: as ``read_grey``.
    """
    content = _content(path)
    _decoded(path, content)  # OpenCV fills what is missing in an incomplete file
    with silent_stderr():
        return _by_opencv(path, content, cv2.IMREAD_GRAYSCALE)


def pixels(content: bytes, place: str) -> NDArray[Any]:
    """Pixels of an image in memory, (height, width) or (height, width, channels), BGR, as deep as it has them.

    Raises:
        ValueError: one line with its place, as ``read_grey``.
    """
    _opened(place, content)
    with silent_stderr():
        return _by_opencv(place, content, cv2.IMREAD_UNCHANGED)


def _by_opencv(place: Path | str, content: bytes, flags: int) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flags)
    if image is None:
        raise _damaged(place)
    return np.asarray(image)


def _content(path: Path) -> bytes:
    if not os.path.lexists(path):
        raise ValueError(f"{path} is missing")
    return read_bytes(path, FileKind.IMAGE)


def _opened(path: Path | str, content: bytes) -> ImageFile:
    """Image with only its header decoded."""
    reader = next((reader for start, reader in _FORMATS if content.startswith(start)), None)
    if content.startswith(_PLAIN):
        raise ValueError(f"{path} has its pixels as text: save it in a binary format, for example PNG")
    if reader is None:
        raise _damaged(path)
    try:
        with _quiet(reader):
            image: ImageFile = reader(io.BytesIO(content))
    except Exception as error:  # a damaged file raises almost anything
        raise _damaged(path) from error
    width, height = image.size
    if not width * height:
        raise _damaged(path)
    if width * height > MAX_PIXELS:
        raise ValueError(
            f"{path} has {width}x{height} px: an image must have at most {MAX_PIXELS // 10**6} megapixels; reduce it"
        )
    return image


def _is_whole_grey_png(content: bytes) -> bool:
    """True for a PNG of 8-bit grey levels, without further data, whose parts all have their checksum."""
    width, height = (int.from_bytes(content[k : k + 4]) for k in (16, 20))
    grey = content.startswith(_FORMATS[0][0]) and content[24:29] == b"\x08\0\0\0\0"
    view, begin, kind = memoryview(content), 8, b"IHDR" if grey and 0 < width * height <= MAX_PIXELS else b""
    while kind in (b"IHDR", b"IDAT") and content[begin + 4 : begin + 8] in (kind, b"IDAT", b"IEND"):
        kind, end = content[begin + 4 : begin + 8], begin + 8 + int.from_bytes(content[begin : begin + 4])
        if zlib.crc32(view[begin + 4 : end]).to_bytes(4) != content[end : end + 4]:
            return False
        begin = end + 4
    return kind == b"IEND"


def _decoded(path: Path, content: bytes) -> ImageFile:
    image = _opened(path, content)
    try:
        with _quiet(type(image)):
            image.load()
    except Exception as error:
        raise _damaged(path) from error
    return image


def _damaged(path: Path | str) -> ValueError:
    return ValueError(f"{path} is corrupt or not an image")


def _quiet(reader: type[ImageFile]) -> AbstractContextManager[None]:
    return silent_stderr() if reader is TiffImageFile else nullcontext()  # only its library writes to the terminal


@contextmanager
def silent_stderr() -> Iterator[None]:
    """Discard what libraries in C write to the terminal about a damaged file."""
    with _STDERR:
        kept = os.dup(2)
        try:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 2)
                yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


class PictureSize(NamedTuple):
    """How pictures are kept for reports."""

    width: int = 100_000  # of wider ones, which are shrunk to it [px]
    quality: int = 95  # of the JPEG

    def jpeg(self, colour: ColourImage | GreyImage) -> bytes:
        """The picture, grey (h, w) or RGB (h, w, 3), as JPEG."""
        height, width = colour.shape[:2]
        if width > self.width:
            times, rest = width // self.width, height % (width // self.width)
            if width % self.width == 0 and 2 * rest <= times <= height:  # whole pixels are ten times as fast
                height -= rest
            size = (self.width, max(1, round(height * self.width / width)))
            colour = colour[:height]
            way = cv2.INTER_AREA if width >= 2 * self.width else cv2.INTER_LINEAR  # four times as fast
            colour = np.asarray(cv2.resize(colour, size, interpolation=way), dtype=np.uint8)
        if colour.ndim == 3:
            colour = np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2BGR), dtype=np.uint8)
        return cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1].tobytes()
