"""Stereo pairs whose exposures are matched, so that no later step compares them again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray


class Turned(NamedTuple):
    """An image as the camera took it, and the homography (3, 3) by which it was resampled."""

    image: GreyImage
    homography: FloatArray

    def resampled(self) -> GreyImage:
        """Image after the homography; edge pixels are repeated."""
        # linear: OpenCV's cubic kernel shifts features by up to 0.04 px, and takes four times as long
        height, width = self.image.shape
        flags, border = cv2.INTER_LINEAR, cv2.BORDER_REPLICATE
        warped = cv2.warpPerspective(self.image, self.homography, (width, height), flags=flags, borderMode=border)
        return np.asarray(warped, dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedFrame(StereoFrame):
    """A stereo pair with the right image exposed like the left one."""

    turned: Turned | None = None  # from which the right image was resampled


def mapped(image: GreyImage, levels: FloatArray) -> GreyImage:
    """Image whose grey levels become ``levels`` (256,), rounded."""
    table = np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table), dtype=np.uint8)


def with_levels(frame: StereoFrame, levels: FloatArray) -> StereoFrame:
    """Frame in whose images grey levels become ``levels`` (256,).

    Resampled images are resampled anew: interpolation moves the edges of what is limited afterwards, but not of what
    the camera itself has clipped, by 0.01 px.
    """
    left, right = mapped(frame.left, levels), mapped(frame.right, levels)
    if not isinstance(frame, MatchedFrame) or frame.turned is None:
        return replace(frame, left=left, right=right)
    turned = frame.turned._replace(image=mapped(frame.turned.image, levels))
    return replace(frame, left=left, right=turned.resampled(), turned=turned)
