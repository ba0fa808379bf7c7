"""Checks of a recording on a few of its images: are they what folders, calibration, wheels and heading say?

Features of a left image are sought in the whole right image, so that what is found does not depend on the
calibration. Pairs are scaled to ``_WIDTH``: seeing which way disparities go needs no more. Of a rover, a camera that is
upside down or mirrored, readings of another drive and a wrong rig give wrong slip angles that look sound.
"""

import math
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.exchange.recordings.writers import RoverRecording
from sensors.camera.rig import RawStereoRig, StereoCalibration
from sensors.messages import GreyImage, RoverView, StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_WIDTH: Final = 640  # of the scaled images [px]
_FEATURES: Final = 500  # of an image
_CORNERS: Final = 800  # of an image that are tracked into the other one
_RETURNED: Final = 0.5  # largest error of a corner tracked there and back [px]
_DISTANCE: Final = 50  # largest distance of two ORB descriptors that match [bits]
_ROW: Final = 1.0  # largest difference of rows of one point in a rectified pair [px]
_FEWEST: Final = 20  # matches of a pair that say something
_CLEARLY: Final = 1.3  # times as many matches that make another pairing the better one
_CLOSER: Final = 1.5  # times the disparity above of that below in pictures that stand on their heads
_FILLED: Final = 0.2  # least share of known disparities in a part of the image that is not sky
RECTIFIED: Final = 0.6  # times the difference of rows once rectified that images have which are so already
_ROWS_APART: Final = 3.0  # median difference of rows that no self-calibration is meant for [px]
_SAME: Final = 0.9  # least share of matches without a disparity in two images that are one
_FLAT: Final = 4.0  # standard deviation of an image without contrast [grey levels]
_OBLONG: Final = 0.1  # largest difference of a camera's focal lengths, relative
_WIDE: Final = 1.5  # baseline that is doubted [m]
_OFF_CENTRE: Final = 0.12  # largest distance of a principal point from the middle, of the image's size


Place: TypeAlias = Callable[[int], StereoFrame | None]  # the frame there (0), before (-1), after (1); None: unreadable


def projection_warnings(calibration: StereoCalibration, raw: RawStereoRig | None) -> list[str]:
    """What makes it doubtful that a calibration, of ``raw`` cameras, belongs to images of its size, a line each."""
    found = [
        f"focal lengths {camera.fx:.0f} and {camera.fy:.0f} px differ: pixels are squares, so are the numbers in "
        "another order?"
        for camera in ((raw.left, raw.right) if raw else ())
        if abs(camera.fx / camera.fy - 1.0) > _OBLONG
    ][:1]
    if calibration.baseline > _WIDE:
        found.append(
            f"baseline {calibration.baseline:.3g} m: is the calibration in metres, not in squares of the board?"
        )
    size = calibration.width, calibration.height
    for name, value, extent in zip(("column", "row"), (calibration.cx, calibration.cy), size, strict=True):
        if abs(value / (extent - 1) - 0.5) > _OFF_CENTRE:
            found.append(
                f"principal point at {name} {value:.0f} of {extent} is far off the middle: is it the calibration of "
                "these images, or were they scaled or cropped after it?"
            )
    return found


def image_warnings(places: Sequence[Place], *, ground_below: bool) -> list[str]:
    """What a few rectified frames show to be wrong, a line each.

    Args:
        places: of the recording.
        ground_below: False if the cameras look down, or are known to be upside down.
    """
    middle = [frame for place in places for frame in islice(filter(None, map(place, (0, 1, -1))), 1)]
    if not middle:
        return []
    contrast = max(cv2.meanStdDev(image)[1].item() for frame in middle for image in (frame.left, frame.right))
    if contrast < _FLAT:
        return [f"the images have hardly any contrast (standard deviation {contrast:.1f} of 255 grey levels)"]
    scale = min(1.0, _WIDTH / middle[0].left.shape[1])
    lefts = [_features(frame.left, scale) for frame in middle]
    own = [_matches(left, _features(frame.right, scale)) for left, frame in zip(lefts, middle, strict=True)]
    pairs = np.concatenate(own)
    if len(pairs) < _FEWEST * len(own):
        return [f"left and right images have hardly a feature in common ({len(pairs)} in {len(own)} pairs)"]
    disparity, rows = (pairs[:, k] - pairs[:, k + 2] for k in (0, 1))
    straight = np.abs(rows) < _ROW
    ahead, back = int(np.sum(straight & (disparity > 0.5))), int(np.sum(straight & (disparity < -0.5)))
    apart = float(np.median(np.abs(rows))) / scale
    found = []
    if np.mean(straight & (np.abs(disparity) <= 0.5)) > _SAME:
        return ["left and right images are the same: name the images of both cameras"]
    exchanged = back > 2 * ahead and back >= _FEWEST
    if exchanged:
        found.append(
            "disparities are negative: are left and right exchanged? Then use --exchange (or are the images mirrored?)"
        )
    elif shift := _shift(places, lefts, own, scale):
        found.append(
            f"right images fit the left ones of the frame {shift} theirs: number both alike from the same instant on; "
            "or has a camera lost a frame under way?"
        )
    elif apart > _ROWS_APART:
        found.append(
            f"rows of left and right images differ by {apart:.1f} px: are they rectified, and with this calibration?"
        )
    if ground_below and all(_upside_down(frame, exchanged=exchanged) for frame in middle):
        found.append("the ground is above the cameras: are they mounted upside down? Then use --upside-down")
    return found


def lens_warnings(raw: Sequence[StereoFrame], rectified: Sequence[StereoFrame]) -> list[str]:
    """A warning if rows agree in images as they are, but not once they are rectified."""
    as_are, once = (rows_apart([(one.left, one.right) for one in frames]) for frames in (raw, rectified))
    if not as_are < RECTIFIED * once or once < _ROW:
        return []
    return [
        f"rows of the images as they are differ by {as_are:.1f} px, once rectified by {once:.1f} px: are they "
        "rectified already, or is the lens of the calibration another one?"
    ]


def rows_apart(pairs: Sequence[Sequence[GreyImage]]) -> float:
    """Difference [px] of the rows of a point in left and right images that a tenth exceeds; infinite without points.

    Corners are tracked there and back by the method of Lucas and Kanade, to a fraction of a pixel: lenses that are
    alike leave errors of a few pixels in near points at the edges only.
    """
    found = [row for pair in pairs for row in _tracked_rows(*pair)]
    return float(np.percentile(found, 90)) if len(found) > _FEWEST else math.inf


def _tracked_rows(left: GreyImage, right: GreyImage) -> NDArray[np.float32]:
    """Differences of rows of corners that are found again in the right image."""
    corners: Any = cv2.goodFeaturesToTrack(left, _CORNERS, 0.005, 8.0)
    if corners is None:
        return np.empty(0, dtype=np.float32)
    there, seen, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, corners.copy(), winSize=(15, 15), maxLevel=5)
    back, again, _ = cv2.calcOpticalFlowPyrLK(right, left, there, there.copy(), winSize=(15, 15), maxLevel=5)
    good = (seen[:, 0] > 0) & (again[:, 0] > 0) & (np.abs(back - corners).max(axis=(1, 2)) < _RETURNED)
    return np.asarray(np.abs(there - corners)[good, 0, 1], dtype=np.float32)


_Features: TypeAlias = tuple[FloatArray, Any]  # points (n, 2) and their descriptors


def _features(image: GreyImage, scale: float) -> _Features:
    scaled = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.ORB.create(_FEATURES, fastThreshold=10).detectAndCompute(scaled, None)
    return np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2), descriptors


def _matches(left: _Features, right: _Features) -> FloatArray:
    """Points (n, 4) that a left and a right image have in common."""
    if left[1] is None or right[1] is None:
        return np.empty((0, 4))
    found = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(left[1], right[1])
    near = [(match.queryIdx, match.trainIdx) for match in found if match.distance < _DISTANCE]
    queries, trained = np.array(near, dtype=np.intp).reshape(-1, 2).T
    return np.hstack([left[0][queries], right[0][trained]])


def _shift(places: Sequence[Place], lefts: Sequence[_Features], own: Sequence[FloatArray], scale: float) -> str:
    """Where the left images are that fit the right ones better than those of their frame; empty if these do.

    Neighbours are looked at in the first place, then where clearly fewer fit: a camera may lose a frame under way.
    """
    best = 1.0  # share of matches that may fit in another pairing
    for place, left, matches in zip(places, lefts, own, strict=False):
        fitting = _fitting(matches)
        if _CLEARLY * fitting > best * len(matches):
            continue
        before, frame, after = map(place, (-1, 0, 1))
        if before is None or frame is None or after is None:
            continue
        others = [_fitting(_matches(left, _features(other.right, scale))) for other in (before, after)]
        if max(others) > max(_CLEARLY * fitting, _FEWEST):
            return "after" if others[0] > others[1] else "before"
        best = max(_fitting(pairs) / max(1, len(pairs)) for pairs in own)  # a place is sound
    return ""


def _fitting(matches: FloatArray) -> int:
    """Number of matches in one row, with the right one further left."""
    disparity, rows = matches[:, 0] - matches[:, 2], matches[:, 1] - matches[:, 3]
    return int(np.sum((np.abs(rows) < 0.5 * _ROW) & (disparity > 0.0)))


def _upside_down(frame: StereoFrame, *, exchanged: bool) -> bool:
    """True if what is in the upper part of the image is closer than what is in its lower part."""
    images = (frame.right, frame.left) if exchanged else (frame.left, frame.right)
    width = _WIDTH // 2
    size = width, max(1, round(frame.left.shape[0] * width / frame.left.shape[1]))
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
    matcher = cv2.StereoSGBM.create(0, width // 10, 5, P1=200, P2=800, disp12MaxDiff=1, uniquenessRatio=10)
    disparity = matcher.compute(*small)[:, width // 10 :]
    third = max(1, len(disparity) // 3)
    above, below = (_typical(part) for part in (disparity[:third], disparity[-third:]))
    return above > _CLOSER * below


def _typical(disparity: NDArray[Any]) -> float:
    """Median of the known disparities; 0 for sky."""
    known = disparity[disparity > 0]
    return float(np.median(known)) if known.size > _FILLED * disparity.size else 0.0


_PAIRS: Final = 20  # of consecutive images that are looked at
_FEWEST_SHIFTS: Final = 5  # pairs that say something
_LEAST: Final = 1.0  # shift that says which way the ground moves [px]
_CLEAR: Final = 0.1  # response of the correlation of images that show the same ground
_RATIOS: Final = 0.25, 2.5  # of the ground's motion to that of the wheels; they slip
_CLEARLY_TURNED: Final = 0.5  # times the squared error of images as they are that makes turned ones the right ones
_TURNED: Final = {  # signs of the images' columns and rows
    (-1, -1): "the ground moves the wrong way in the images: is the camera upside down? Then use --upside-down",
    (1, -1): "the ground moves the wrong way in the images: are they upside down and mirrored, or in reversed order?",
    (-1, 1): "the ground turns the wrong way in the images: are they mirrored, or is the heading + to the right?",
}


class Flow(NamedTuple):
    """What the motion of the ground shows, a line each."""

    warnings: tuple[str, ...] = ()  # of what is wrong
    notes: tuple[str, ...] = ()  # of what cannot be decided


_UNDECIDED: Final = (
    "whether the images are mirrored can not be decided: the rover hardly turns; a mirrored camera gives the slip "
    "angle the wrong sign"
)


def ground_flow(recording: RoverRecording) -> Flow:
    """What the motion of the ground in a rover's images shows to be wrong.

    Shifts of both halves of the images are compared with those of turned and mirrored ones.
    """
    shifts = []
    last = len(recording.images) - 2
    for k in np.unique(np.linspace(0, max(0, last), _PAIRS).astype(int)).tolist():
        before, after = (recording.view(j) if j <= last + 1 else "" for j in (k, k + 1))
        if isinstance(before, str) or isinstance(after, str):
            continue
        expected = _expected(recording, before, after)
        found = np.array([_half_shift(before, after, side) for side in (0, 1)])
        if np.isfinite(found).all() and np.linalg.norm(expected.mean(axis=0)) > _LEAST:
            shifts.append((expected, found))
    if len(shifts) < _FEWEST_SHIFTS:
        return Flow(notes=(_UNDECIDED,))
    expected, found = (np.array(values) for values in zip(*shifts, strict=True))
    errors = {
        signs: float(np.median(np.square(found[:, :: signs[0]] * signs - expected).sum(axis=(1, 2))))
        for signs in ((1, 1), *_TURNED)
    }
    best = min(errors, key=errors.__getitem__)
    if best in _TURNED and errors[best] < _CLEARLY_TURNED * errors[1, 1]:
        return Flow((_TURNED[best],))
    notes = () if errors[1, 1] < _CLEARLY_TURNED * errors[-1, 1] else (_UNDECIDED,)
    ratio = float(np.median((found * expected).sum(axis=(1, 2)) / np.square(expected).sum(axis=(1, 2))))
    if _RATIOS[0] < ratio < _RATIOS[1]:
        return Flow(notes=notes)
    far = f"the ground moves {ratio:.2g} times as far in the images as the wheels say"
    return Flow((f"{far}: do rig, wheel radius and times belong to these images?",), notes)


def _expected(recording: RoverRecording, before: RoverView, after: RoverView) -> FloatArray:
    """Shifts (2, 2) [px] of the ground in the middle of the left and right half of the image, without slip."""
    rig = recording.rig
    travel = rig.wheel_radius * float(np.mean(after.wheel_speeds)) * (after.tick - before.tick) * TICK
    turn = after.heading - before.heading
    H = rig.image_of_ground()
    height, width = before.image.shape
    pixels = np.array([[share * width, 0.5 * height, 1.0] for share in (0.25, 0.75)]).T
    ground = np.linalg.inv(H) @ pixels
    ground /= ground[2]
    c, s = np.cos(turn), np.sin(turn)
    moved = np.array([[c, s, -travel * c], [-s, c, travel * s], [0.0, 0.0, 1.0]]) @ ground
    seen = H @ moved
    shifts: FloatArray = (seen[:2] / seen[2] - pixels[:2]).T
    return shifts


def _half_shift(before: RoverView, after: RoverView, side: int) -> FloatArray:
    """Shift (2,) [px] of the left or right half of the image; NaN if it shows other ground."""
    height, width = before.image.shape
    rows, columns = slice(height // 4, 3 * height // 4), slice(side * width // 2, (side + 1) * width // 2)
    one, other = (np.ascontiguousarray(view.image[rows, columns], dtype=np.float32) for view in (before, after))
    window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(one, other, window)
    return np.array(shift) if response > _CLEAR else np.full(2, np.nan)
