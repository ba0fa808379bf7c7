"""Lossless images on disk."""

from __future__ import annotations

from pathlib import Path

import cv2

from sensors.messages import GreyImage

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # noise compresses no better at 9, only ten times more slowly


def write_png(path: Path, image: GreyImage) -> None:
    """Write a grey image.

    Raises:
        OSError: if it could not be written.
    """
    if not cv2.imwrite(str(path), image, _FAST_PNG):
        raise OSError(f"could not write {path}: is the disk full?")
