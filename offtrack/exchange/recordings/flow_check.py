"""Check of a rover's recording: does the ground move in the images as wheels and heading say?

A camera that is upside down or mirrored, readings of another drive and a wrong rig give wrong slip angles that look
sound: the trace is a straight line either way.
"""

from typing import Final

import cv2
import numpy as np

from offtrack.exchange.recordings.writers import RoverRecording
from sensors.messages import RoverView
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_PAIRS: Final = 20  # of consecutive images that are looked at
_FEWEST: Final = 5  # pairs that say something
_LEAST: Final = 1.0  # shift that says which way the ground moves [px]
_CLEAR: Final = 0.1  # response of the correlation of images that show the same ground
_RATIOS: Final = 0.25, 2.5  # of the ground's motion to that of the wheels; they slip
_CLEARLY: Final = 0.5  # times the squared error of images as they are that makes turned ones the right ones
_TURNED: Final = {  # signs of the images' columns and rows
    (-1, -1): "the ground moves the wrong way in the images: is the camera upside down? Then use --upside-down",
    (1, -1): "the ground moves the wrong way in the images: are they upside down and mirrored, or in reversed order?",
    (-1, 1): "the ground turns the wrong way in the images: are they mirrored, or is the heading + to the right?",
}


def flow_warnings(recording: RoverRecording) -> list[str]:
    """What the motion of the ground shows to be wrong, a line; nothing if the rover hardly moves.

    Shifts of both halves of the images are compared with those of turned and mirrored ones.
    """
    shifts = []
    last = len(recording.images) - 2
    for k in np.unique(np.linspace(0, max(0, last), _PAIRS).astype(int)).tolist():
        before, after = (recording.view(j) if j <= last + 1 else "" for j in (k, k + 1))
        if isinstance(before, str) or isinstance(after, str):
            continue
        expected = _expected(recording, before, after)
        found = np.array([_shift(before, after, side) for side in (0, 1)])
        if np.isfinite(found).all() and np.linalg.norm(expected.mean(axis=0)) > _LEAST:
            shifts.append((expected, found))
    if len(shifts) < _FEWEST:
        return []
    expected, found = (np.array(values) for values in zip(*shifts, strict=True))
    errors = {
        signs: float(np.median(np.square(found[:, :: signs[0]] * signs - expected).sum(axis=(1, 2))))
        for signs in ((1, 1), *_TURNED)
    }
    best = min(errors, key=errors.__getitem__)
    if best in _TURNED and errors[best] < _CLEARLY * errors[1, 1]:
        return [_TURNED[best]]
    ratio = float(np.median((found * expected).sum(axis=(1, 2)) / np.square(expected).sum(axis=(1, 2))))
    if _RATIOS[0] < ratio < _RATIOS[1]:
        return []
    return [
        f"the ground moves {ratio:.2g} times as far in the images as the wheels say: do rig, wheel radius and times "
        "belong to these images?"
    ]


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


def _shift(before: RoverView, after: RoverView, side: int) -> FloatArray:
    """Shift (2,) [px] of the left or right half of the image; NaN if it shows other ground."""
    height, width = before.image.shape
    rows, columns = slice(height // 4, 3 * height // 4), slice(side * width // 2, (side + 1) * width // 2)
    one, other = (np.ascontiguousarray(view.image[rows, columns], dtype=np.float32) for view in (before, after))
    window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
    shift, response = cv2.phaseCorrelate(one, other, window)
    return np.array(shift) if response > _CLEAR else np.full(2, np.nan)
