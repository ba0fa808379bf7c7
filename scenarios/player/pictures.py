"""Pictures of a playback, made small enough for one page: fewer pixels first, then fewer pictures."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.player.playback import Picture

STROKES: Final = 160  # over a picture
_SIZES: Final = ((672, 50), (560, 45), (480, 42), (416, 40))  # width [px] and JPEG quality, best first
_TRIED: Final = 8  # pictures whose size is measured
_HALVED: Final = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
_MARGIN: Final = 1.1  # pictures that were not tried may be larger


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmallPicture:
    """A picture as it is on the page."""

    picture: Picture
    jpeg: bytes
    scale: float  # of its pixels to those of the original


def small_pictures(pictures: Sequence[Picture], room: int) -> tuple[list[SmallPicture], str]:
    """Pictures that take up at most about ``room`` bytes, and a sentence on what was left out; empty if nothing was.

    A picture that can't be decoded is left out.
    """
    if not pictures:
        return [], ""
    tried = pictures[:: max(1, len(pictures) // _TRIED)]
    for width, quality in _SIZES:
        sizes = [len(small.jpeg) for small in (_small(one, width, quality) for one in tried) if small]
        whole = _MARGIN * float(np.mean(sizes or [0])) * len(pictures)
        if whole <= room:
            break
    stride = max(1, int(np.ceil(whole / max(room, 1))))
    kept = pictures[::stride]
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:  # OpenCV works outside Python's lock
        small = [one for one in pool.map(lambda picture: _small(picture, width, quality), kept) if one]
    left_out = f" Every {_ordinal(stride)} of them is shown." if stride > 1 else ""
    return small, f"{len(pictures)} pictures of the camera, {width} px wide at most.{left_out}"


def _small(picture: Picture, width: int, quality: int) -> SmallPicture | None:
    data = np.frombuffer(picture.jpeg, np.uint8)
    original = _width(picture.jpeg)
    factor = max((k for k in _HALVED if original >= k * width), default=1)
    image = cv2.imdecode(data, _HALVED[factor])
    if image is None:
        return None
    if image.shape[1] > 1.05 * width:
        size = (width, max(1, round(width * image.shape[0] / image.shape[1])))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return SmallPicture(picture=picture, jpeg=jpeg, scale=image.shape[1] / max(original, 1))


def _width(jpeg: bytes) -> int:
    """Width of a JPEG image [px], from its frame header; 0 if there is none."""
    at = 2
    while at + 9 < len(jpeg) and jpeg[at] == 0xFF:
        if jpeg[at + 1] in (0xC0, 0xC1, 0xC2):
            return int.from_bytes(jpeg[at + 7 : at + 9], "big")
        at += 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    return 0


def live_picture(picture: Picture) -> dict[str, Any]:
    """A picture as a page gets it while the run goes on, ready for JSON."""
    small = _small(picture, *_SIZES[0])
    return {
        "time": picture.time,
        "base64": base64.b64encode(small.jpeg).decode() if small else "",
        "caption": picture.caption,
        "strokes": strokes_of(small, STROKES).ravel().tolist() if small else [],
        "lines": list(picture.lines),
    }


def strokes_of(small: SmallPicture, most: int) -> NDArray[np.int16]:
    """Strokes on the small picture in eighths of its pixels, (n, 4); of more than ``most`` every second, third, …."""
    strokes = small.picture.strokes
    if not small.picture.lines and len(strokes) > most:
        strokes = strokes[:: -(-len(strokes) // most)]
    eighths: NDArray[np.int16] = np.clip(np.rint(8.0 * small.scale * (strokes + 0.5)), -32768, 32767).astype(np.int16)
    return eighths


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")
