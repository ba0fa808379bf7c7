"""Corrections of a pair by the estimated state of its right camera: when they change, and how they are applied."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.calibration.mount_state import DELAY, MountState, PairGeometry
from estimators.calibration.right_rotation import RightRotation, homography
from estimators.displaced_right import DisplacedFrame
from estimators.matched_frame import MatchedFrame, Turned
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame

# Changes of roll, yaw and pitch that are applied, at the cost of a restart of the odometry [standard deviations].
_WORTH = np.array([2.5, 1.0, 2.5])
LEAST_ANGLES = np.radians([0.01, 0.0025, 0.01])  # least roll, yaw, pitch that matter: 1 mm of off-tracking [rad]
_LEAST_DELAY = 3e-4  # least delay that matters: a displacement of 5 mm at 60 km/h [s]
_LATE = 4.0  # delay that is compensated [standard deviations]: most pairs are simultaneous
_REFINED = 2e-3  # change of a delay that needs no restart: a displacement of 3 cm at 60 km/h [s]
_SOUND = 2.0  # below it a delay is compensated no longer [standard deviations]


class Corrections(NamedTuple):
    """Rotation and delay of the right camera that are removed from its images."""

    rotation: RightRotation
    delay: float  # [s]


NONE = Corrections(RightRotation(0.0, 0.0, 0.0), 0.0)


def of_rotation(state: MountState, applied: Corrections, *, at_once: bool = False) -> Corrections:
    """Corrections with the estimated rotation, or those of before if the change is not worth a restart.

    With ``at_once`` uncertain angles count as well.
    """
    off = np.abs(state.mean[:3] - applied.rotation)
    worth = (off > np.maximum(0.0 if at_once else _WORTH * state.std[:3], LEAST_ANGLES)).any()
    return applied._replace(rotation=state.rotation) if worth else applied


def of_delay(state: MountState, applied: Corrections) -> Corrections:
    """Corrections with the estimated delay, if it is significant."""
    delay, std = float(state.mean[DELAY]), float(state.std[DELAY])
    limit = _SOUND if applied.delay else _LATE
    return applied._replace(delay=delay if abs(delay) > max(limit * std, _LEAST_DELAY) else 0.0)


def is_another(new: Corrections, old: Corrections) -> bool:
    """True if images with both corrections do not fit together; a delay may be refined."""
    refined = bool(new.delay) == bool(old.delay) and abs(new.delay - old.delay) < _REFINED
    return new.rotation != old.rotation or not refined


def corrected(
    calibration: StereoCalibration, frame: StereoFrame, rotation: RightRotation, geometry: PairGeometry
) -> StereoFrame:
    """Frame with the right image in the calibrated attitude, and with its displacement; itself if there is neither.

    The exposures of the frame are matched already.
    """
    if not any(rotation) and geometry.shift is None:
        return frame
    turned = Turned(frame.right, homography(calibration, geometry.attitude(rotation)))
    tick, left, right, colour = frame.tick, frame.left, turned.resampled(), frame.colour
    if geometry.shift is None:
        return MatchedFrame(tick=tick, left=left, right=right, colour=colour, turned=turned)
    return DisplacedFrame(tick=tick, left=left, right=right, colour=colour, turned=turned, right_shift=geometry.shift)
