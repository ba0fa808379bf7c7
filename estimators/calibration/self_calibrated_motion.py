"""Motions with the estimated state of the right camera, and with its errors in their covariance and health."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from estimators.calibration.calibration_doubt import doubt_covariance
from estimators.calibration.corrections import LEAST_ANGLES, Corrections
from estimators.calibration.mount_state import DELAY, MountState
from estimators.calibration.right_rotation import RightRotation
from estimators.estimates import Health, Motion, lost_motion
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray

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


def with_calibration(
    calibration: StereoCalibration, motion: Motion, state: MountState, doubt: Doubt
) -> SelfCalibratedMotion:
    """Motion message with the state, and with the doubt in covariance and health."""
    if Health.LOST in (doubt.health, motion.health):
        motion = lost_motion(motion.tick, motion.previous_tick, motion.matches)
    values = {field.name: getattr(motion, field.name) for field in fields(motion)}
    if motion.health is not Health.LOST:
        by_doubt = doubt_covariance(calibration, motion.X_PC, doubt.angles, doubt.shift)
        values["covariance"] = motion.covariance + by_doubt
        values["health"] = doubt.health if motion.health is Health.OK else motion.health
    if motion.anchor is not None:
        by_doubt = doubt_covariance(calibration, motion.anchor.X_AC, doubt.angles, doubt.shift)
        values["anchor"] = replace(motion.anchor, covariance=motion.anchor.covariance + by_doubt)
    return SelfCalibratedMotion(
        **values,
        right_rotation=state.rotation,
        right_rotation_std=RightRotation(*_std(state).tolist()),
        right_delay=float(state.mean[DELAY]),
        right_delay_std=math.sqrt(state.covariance[DELAY, DELAY]),
        miscalibrated=doubt.refuted,
    )


def _std(state: MountState) -> FloatArray:
    """Standard deviations (3,) of the angles, with the common error of all views."""
    std: FloatArray = np.hypot(state.std[:3], _SYSTEMATIC)
    return std
