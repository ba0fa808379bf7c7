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
_APART = 10.0  # distance beyond which a new reference view is taken: views share too few points [m]
_REST = 5.0  # distance from a reference view that a turn took out of sight to the next, while yaw is known [m]
_TURNED = np.radians(15.0)  # rotation between two views at which yaw is measured: beyond it they share few points
_SHIFTED = 0.015  # displacement of the right camera that is beyond errors of lenses [m]
_SHIFTED_SHARE = 0.05  # the same, as a share of the displacement that is compensated
_PROVEN = 5.0  # distance of motions after which a new estimate is no passing disturbance [m]
_SIGNIFICANT = 8.0  # the same in standard deviations of a fit, which are half of the real ones


class Taken(NamedTuple):
    """A frame as it came, and the velocity before it."""

    frame: StereoFrame
    twist: Twist
    lost: bool = False  # True if no motion ended at it
    left_over: float = 0.0  # displacement of its right image that was not compensated [m]


class Earlier(NamedTuple):
    """Estimate from before pairs contradicted it, kept until motions have proven the new one."""

    state: MountState
    agreed: bool = False  # True if the newest pair is as before
    proven: float = 0.0  # distance of motions with the new one [m]

    def after(self, distance: float) -> Earlier | None:
        """The earlier estimate after a motion of some distance [m]; None once the new one is proven."""
        proven = self.proven + distance
        return self._replace(proven=proven) if proven < _PROVEN else None


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """Memory of the odometry, the estimate, and the reference view."""

    odometry: Memory
    state: MountState
    applied: Corrections = NONE
    twist: Twist = UNKNOWN  # by the last motion
    fresh: float | None = None  # distance since the last fit to a single pair [m]; None: there is none
    previous: tuple[Taken, ...] = ()  # newest frames of the odometry, oldest first
    suspect: StereoFrame | None = None  # newest frame, if it contradicts the estimate
    earlier: Earlier | None = None  # estimate to which a passing disturbance returns
    shift: float = 0.0  # displacement of the right camera along the optical axis, by the newest frame [m]
    assumed: float = 0.0  # the same for the first motion, as long as no velocity relates it to a delay [m]
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    look: float = 0.0  # distance from the view at which yaw is measured next [m]
    clipped: float = 0.0  # share of clipped pixels in the images of late
    rest: float = 0.0  # distance from the last view before which none is needed, unless yaw is in doubt [m]


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
    return _FIRST_LOOK_IN_DOUBT if _in_doubt(state) else _FIRST_LOOK


def look_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame is far enough from the reference view, or nearly too far rotated."""
    if memory.view is None:
        return False
    return _shift(memory) > memory.look or _is_turned(memory)


def looked(memory: SelfCalibrationMemory[Memory]) -> SelfCalibrationMemory[Memory]:
    """Memory after a look at yaw; a view is looked at once after a turn, since later frames share too few points."""
    if _is_turned(memory):
        return memory._replace(view=None, rest=_REST)
    return memory._replace(look=2.0 * _shift(memory))


def view_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame becomes the reference view."""
    if memory.view is None:
        return _in_doubt(memory.state) or _shift(memory) >= memory.rest
    return memory.look > _APART


def _shift(memory: SelfCalibrationMemory[Memory]) -> float:
    """Distance of the newest frame from the view [m]."""
    return float(np.linalg.norm(memory.X_VC[:3, 3]))


def _is_turned(memory: SelfCalibrationMemory[Memory]) -> bool:
    turn = np.linalg.norm(rotation_vector(memory.X_VC[:3, :3]))
    return bool(turn > _TURNED and _shift(memory) > _FIRST_LOOK_IN_DOUBT)


def _in_doubt(state: MountState) -> bool:
    return bool(state.covariance[YAW, YAW] > _DOUBT**2)
