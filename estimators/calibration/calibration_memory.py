"""Memory of the self-calibration, and what follows from it."""

from __future__ import annotations

from typing import Generic, NamedTuple

import numpy as np

from estimators.calibration.corrections import NONE, Corrections
from estimators.calibration.epipolar import EpipolarFit
from estimators.calibration.mount_state import UNKNOWN, YAW, MountState, PairGeometry, Twist, geometry
from estimators.calibration.rotation_views import View
from estimators.protocol import Memory
from estimators.rigid_motion import rotation_vector
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

# Distances from the reference view at which yaw is measured: the first one, and then the double of the last. An early
# coarse value is better than a late fine one, but errors of lenses matter less from afar [m].
_FIRST_LOOK, _FIRST_LOOK_IN_DOUBT = 4.0, 0.9
_DOUBT = np.radians(0.01)  # of yaw, 1 sigma: more counts as uncertain and costs 6 mm of off-tracking [rad]
_TURNED = np.radians(15.0)  # rotation between two views at which yaw is measured: beyond it they share few points
_SHIFTED = 0.015  # displacement of the right camera that is beyond errors of lenses [m]
_SHIFTED_SHARE = 0.05  # the same, as a share of the displacement that is compensated
_SIGNIFICANT = 8.0  # the same in standard deviations of a fit, which are half of the real ones


class Taken(NamedTuple):
    """A frame as it came, and the velocity before it."""

    frame: StereoFrame
    twist: Twist


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """Memory of the odometry, the estimate, and the reference view."""

    odometry: Memory
    state: MountState
    applied: Corrections = NONE
    twist: Twist = UNKNOWN  # by the last motion
    fresh: float | None = None  # distance since the last fit to a single pair [m]; None: there is none
    previous: tuple[Taken, ...] = ()  # newest frames of the odometry, oldest first
    suspect: StereoFrame | None = None  # newest frame, if it contradicts the estimate
    shift: float = 0.0  # displacement of the right camera along the optical axis, by the newest frame [m]
    assumed: float = 0.0  # the same for the first motion, as long as no velocity relates it to a delay [m]
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    look: float = 0.0  # distance from the view at which yaw is measured next [m]


def pair_geometry(memory: SelfCalibrationMemory[Memory], baseline: float) -> PairGeometry:
    """Geometry of the corrected pairs; before the first motion, a displacement along the optical axis at most."""
    if memory.assumed:
        return PairGeometry(np.eye(3), np.array([0.0, 0.0, memory.assumed]))
    return geometry(memory.applied.delay, memory.twist, baseline)


def left_over(memory: SelfCalibrationMemory[Memory], baseline: float) -> float:
    """Displacement [m] of the newest right camera that is not compensated; 0 if it is not significant."""
    applied = pair_geometry(memory, baseline).shift
    compensated = 0.0 if applied is None else float(applied[2])
    remaining = abs(memory.shift - compensated) if memory.shift else 0.0
    return remaining if remaining > max(_SHIFTED, _SHIFTED_SHARE * abs(compensated)) else 0.0


def significant_shift(fit: EpipolarFit) -> float:
    """Displacement [m] of the right camera along the optical axis by a single pair; 0 if it is not significant."""
    shift = float(fit.values[3])
    return shift if abs(shift) > max(_SHIFTED, _SIGNIFICANT * float(np.sqrt(fit.covariance[3, 3]))) else 0.0


def first_look(state: MountState) -> float:
    """Distance from a new reference view at which yaw is measured first [m]."""
    return _FIRST_LOOK_IN_DOUBT if state.covariance[YAW, YAW] > _DOUBT**2 else _FIRST_LOOK


def look_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame is far enough from the reference view, or nearly too far rotated."""
    if memory.view is None:
        return False
    shift, turn = np.linalg.norm(memory.X_VC[:3, 3]), np.linalg.norm(rotation_vector(memory.X_VC[:3, :3]))
    return bool(shift > memory.look or (turn > _TURNED and shift > _FIRST_LOOK_IN_DOUBT))
