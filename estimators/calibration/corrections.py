"""Corrections of a pair by the estimated state of its right camera, and motions measured with them."""

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypeVar

import numpy as np

from estimators.calibration.epipolar import RightRotation, homography
from estimators.calibration.mount_state import DELAY, MountState, PairGeometry
from estimators.estimates import Anchor, Health, Motion, lost_motion
from estimators.stereo_pair import CorrectedFrame, Turned
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

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
    """Frame with the right image in the calibrated attitude, and with its displacement; itself if there is neither."""
    if not any(rotation) and geometry.shift is None:
        return frame
    turned = Turned(frame.right, homography(calibration, geometry.attitude(rotation)))
    return CorrectedFrame(
        tick=frame.tick,
        left=frame.left,
        right=turned.resampled(),
        colour=frame.colour,
        turned=turned,
        right_shift=geometry.shift,
    )


# All of these were measured with keyframe and circular odometry on rendered drives: by 0.15 deg of roll and yaw and 0.1
# deg of pitch, and by pairs 10 to 50 ms apart at 10 to 60 km/h.
_SEEN_DEPTH = 5.3  # depth at which a disparity error scales the motion, in camera heights
_ALONG = np.array([0.2, 1.0, 0.1])  # scale error by roll, yaw and pitch, relative to that by yaw
_ACROSS = np.array([0.3, 1.0, 0.6])  # the same for the directions that a scale error does not change
_SIDEWAYS, _TURN = 0.1, 0.006  # those errors: share of the distance, and per distance [rad/m]
# The same by a displacement of one baseline along the optical axis, by which depths are wrong in proportion to x.
_BY_SHIFT = np.array([0.4, 0.07, 0.006])
_ALIKE_OVER, _LEAST_DISTANCE = 14.0, 0.01  # the latter lasts over the first, but for changes of the velocity [m]


def _errors(X: FloatArray, sizes: FloatArray) -> FloatArray:
    """Errors (6, 7) of a motion X (4, 4), 1 sigma each: scaled, turned about and moved along each of the axes.

    The ``sizes`` (3,) are the scale, the share of the distance that it is moved by, and the turn per distance [rad/m].
    """
    p, (along, sideways, turn) = X[:3, 3], sizes * np.append(1.0, np.full(2, np.linalg.norm(X[:3, 3])))
    return np.column_stack([np.append(np.zeros(3), along * p), np.diag([turn] * 3 + [sideways] * 3)])


_SYSTEMATIC = np.radians([0.001, 0.001, 0.0005])  # error common to all views: measured over rendered drives [rad]
_REFUTED = 4.0  # angle by which a calibration that is not corrected counts as refuted [standard deviations]
_UNLIKELY = np.radians([1.0, 0.25, 1.0])  # angle beyond all errors of lenses: refuted even while uncertain [rad]
_TOLERATED = np.radians([0.1, 0.03, 0.1])  # error of a calibration with which motions stay OK: 1 % of scale [rad]
_UNUSABLE = np.radians([0.5, 0.2, 0.5])  # error beyond which motions are lost: their errors are no longer small [rad]
_YAW_RATE = 0.003  # change of the yaw rate within a frame as a trailer turns in: over a delay it looks like yaw [rad/s]
_TOO_FAR = 0.25  # displacement that is not compensated, beyond which motions are lost [baselines]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfCalibratedMotion(Motion):
    """Motion with the estimated rotation and delay of the right camera at its end."""

    right_rotation: RightRotation  # [rad]
    right_rotation_std: RightRotation  # [rad]
    right_delay: float  # + the right camera exposes later [s]
    right_delay_std: float  # [s]
    miscalibrated: bool  # True: the calibration is refuted and not corrected, so the motion is degraded or lost


class Doubt(NamedTuple):
    """Errors of a pair that are not corrected, 1 sigma, and the health that they leave."""

    angles: FloatArray  # (3,) roll, yaw, pitch [rad]
    shift: float  # of the right camera along the optical axis [m]
    health: Health
    refuted: bool  # True: angles are why the health is not OK


def doubt(
    calibration: StereoCalibration,
    state: MountState,
    applied: Corrections,
    speed: float,
    left_over: float,
    *,
    correcting: bool,
) -> Doubt:
    """Doubt of a pair with these corrections.

    Args:
        calibration: of the pair.
        state: estimated.
        applied: corrections, those of the rotation only if ``correcting``.
        speed: of the camera [m/s].
        left_over: displacement of the right camera that the pair shows beyond the compensated one [m].
        correcting: whether the rotation is corrected. If not, only what refutes the calibration counts.
    """
    off, std = np.abs(state.mean[:3] - applied.rotation), _std(state)
    angles = np.hypot(std, off)
    turned = np.array([0.0, _YAW_RATE * applied.delay, 0.0])
    if not correcting:
        unlikely = (off > np.maximum(_REFUTED * std, LEAST_ANGLES)) | (off > _UNLIKELY)
        angles = np.where(unlikely, angles, 0.0)
    refuted = not correcting and bool((angles > _TOLERATED).any())
    lost = (refuted and bool((angles > _UNUSABLE).any())) or abs(left_over) > _TOO_FAR * calibration.baseline
    health = Health.LOST if lost else Health.DEGRADED if refuted or left_over else Health.OK
    late = speed * float(state.std[DELAY]) if applied.delay else 0.0
    return Doubt(np.hypot(angles, turned), math.hypot(left_over, late), health, refuted)


_Measured = TypeVar("_Measured", Motion, Anchor)


def with_calibration(
    calibration: StereoCalibration, motion: Motion, state: MountState, doubt: Doubt
) -> SelfCalibratedMotion:
    """Motion message with the state, and with the doubt in covariance and health."""
    scale = _SEEN_DEPTH * float(calibration.X_SC[2, 3]) / calibration.baseline * doubt.angles
    along, across = (float(np.linalg.norm(share * scale)) for share in (_ALONG, _ACROSS))
    by_angles = np.array([along, _SIDEWAYS * across, _TURN * across])

    def doubted(one: _Measured) -> _Measured:
        X = one.uncertain.X
        errors = _errors(X, by_angles)
        covariance = one.covariance + errors @ errors.T
        if doubt.shift:
            late = _errors(X, doubt.shift / calibration.baseline * _BY_SHIFT)
            covariance += max(1.0, _ALIKE_OVER / max(float(np.linalg.norm(X[:3, 3])), _LEAST_DISTANCE)) * late @ late.T
        return replace(one, covariance=covariance, common=np.hstack([one.common[:, :6], errors]))

    if Health.LOST in (doubt.health, motion.health):
        motion = lost_motion(motion.tick, motion.previous_tick, motion.matches)
    else:
        health = doubt.health if motion.health is Health.OK else motion.health
        motion = replace(doubted(motion), health=health, anchor=motion.anchor and doubted(motion.anchor))
    return SelfCalibratedMotion(
        **{field.name: getattr(motion, field.name) for field in fields(motion)},
        right_rotation=state.rotation,
        right_rotation_std=RightRotation(*_std(state).tolist()),
        right_delay=float(state.mean[DELAY]),
        right_delay_std=math.sqrt(state.covariance[DELAY, DELAY]),
        miscalibrated=doubt.refuted,
    )


def _std(state: MountState) -> FloatArray:
    """Standard deviations (3,) of the angles, with the common error of all views."""
    return np.hypot(state.std[:3], _SYSTEMATIC)
