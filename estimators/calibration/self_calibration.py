"""Online self-calibration: an odometry that estimates the rotation of the right camera and corrects its images.

A mount bent by a tenth of a degree biases the off-tracking by decimetres (de Saxe 2018, section 4.3). Roll, yaw and
pitch are estimated continuously, as the mount may keep bending: roll and pitch from the rows of single pairs, yaw from
pairs some metres apart. The right image is corrected by them (eqs 8 and 9) before the odometry. Not modelled: rotation
of the left camera (to first order equivalent), translation of the cameras.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Generic, NamedTuple

import numpy as np

from estimators.calibration.right_rotation import RightRotation, straightened
from estimators.calibration.rotation_fit import Estimate, from_motion, from_rows
from estimators.calibration.rotation_views import FEWEST, View, new_view, rematched
from estimators.estimates import Health, Motion
from estimators.odometry.exposure import alike
from estimators.protocol import Memory, Odometry
from estimators.rigid_motion import chained, rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_MOUNT = np.radians([0.1, 0.1, 0.1])  # prior rotation of a mount, 1 sigma: de Saxe 2018
_BENDS = np.radians([0.002, 0.001, 0.002])  # random walk of the mount over distance, 1 sigma [rad/sqrt(m)]
_SYSTEMATIC = np.radians([0.001, 0.001, 0.0005])  # error common to all views: measured over rendered drives [rad]
_APART = 5.0  # distance between the two views for yaw [m]
_APART_IN_DOUBT = 1.0  # the same while yaw is uncertain: an early coarse value is better than a late fine one [m]
_DOUBT = np.radians(0.01)  # of yaw, 1 sigma: more counts as uncertain and costs 6 mm of off-tracking [rad]
_TURNED = np.radians(15.0)  # largest rotation between two views; beyond it they share few points
_LEAST_APART = 0.9  # least distance between two views for depth from parallax [m]
_WORTH_IT = 1.5  # change of the rotation that is applied to the images [standard deviations]
_LEAST_WORTH = np.radians([0.005, 0.002, 0.005])  # least change applied: below 1 mm of off-tracking [rad]
_LEAST_DISTANCE = 0.01  # below it the trailer stands [m]
_SEEN_DEPTH = 3.3  # depth of the points that determine the motion, in camera heights
_CONSTANT_OVER = 14.0  # distance over which an error of the rotation is constant, so that its effects add linearly [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfCalibratedMotion(Motion):
    """Motion with the estimated rotation of the right camera at its end."""

    right_rotation: RightRotation  # [rad]
    right_rotation_std: RightRotation  # [rad]


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """Memory of the odometry, the estimate, and the reference view."""

    odometry: Memory
    estimate: Estimate
    applied: RightRotation  # rotation that images are corrected by
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    started: bool = False  # True: the odometry has had a frame


class SelfCalibratedOdometry(Generic[Memory]):
    """Odometry on corrected images, with self-calibration around it."""

    def __init__(self, calibration: StereoCalibration, odometry: Odometry[Memory], *, seed: int = 0) -> None:
        """Self-calibration around an odometry; ``seed`` and a frame's tick fix all random draws."""
        self._calibration, self._odometry, self._seed = calibration, odometry, seed

    def init(self) -> SelfCalibrationMemory[Memory]:
        """Memory before the first frame."""
        straight = RightRotation(0.0, 0.0, 0.0)
        return SelfCalibrationMemory(self._odometry.init(), Estimate(np.zeros(3), np.diag(_MOUNT**2)), straight)

    def step(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], SelfCalibratedMotion | None]:
        """Memory with the frame in it, and the motion that ends at it; None for the first frame."""
        frame = alike(self._calibration, frame)
        from_here = memory.view is None
        if from_here:
            memory = self._with_view(memory, frame)
            memory = memory if memory.started else self._applied(memory)
        odometry, motion = self._odometry.step(memory.odometry, self._straightened(frame, memory.applied))
        memory = memory._replace(odometry=odometry, started=True)
        if motion is None:
            return memory, None
        if motion.health is Health.LOST:
            return memory._replace(view=None), self._message(motion, memory)
        memory = self._moved(memory, motion)
        if from_here:
            return memory._replace(X_VC=np.eye(4)), self._message(motion, memory)
        message = self._message(motion, memory)
        if not _view_due(memory):
            return memory, message
        memory = self._with_view(self._with_yaw(memory, frame), frame)
        again = self._applied(memory)
        if again.applied != memory.applied:  # the odometry's memory is of images with the old correction
            odometry, _ = self._odometry.step(self._odometry.init(), self._straightened(frame, again.applied))
            again = again._replace(odometry=odometry)
        return again, message

    def _straightened(self, frame: StereoFrame, rotation: RightRotation) -> StereoFrame:
        if not any(rotation):
            return frame
        return replace(frame, right=straightened(self._calibration, frame.right, rotation))

    def _moved(self, memory: SelfCalibrationMemory[Memory], motion: Motion) -> SelfCalibrationMemory[Memory]:
        """Memory after the motion, with the random walk of the mount."""
        distance = float(np.linalg.norm(motion.X_PC[:3, 3]))
        angles, covariance = memory.estimate
        estimate = Estimate(angles, covariance + np.diag(_BENDS**2 * distance))
        return memory._replace(estimate=estimate, X_VC=chained(memory.X_VC, motion.X_PC))

    def _with_yaw(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with yaw from the frame and the reference view."""
        if memory.view is None or np.linalg.norm(memory.X_VC[:3, 3]) < _LEAST_APART:
            return memory
        estimate = memory.estimate
        pairs = rematched(self._calibration, memory.view, frame, memory.X_VC, estimate.rotation)
        update = from_motion(self._calibration, *pairs, memory.X_VC, estimate)
        return memory if update is None else memory._replace(estimate=update)

    def _with_view(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """Memory with the frame as its reference view, and roll and pitch from its rows."""
        rng = np.random.default_rng([self._seed, frame.tick, 2])
        doubt = float(np.sqrt(np.diag(memory.estimate.covariance)).max())
        view = new_view(self._calibration, frame, memory.estimate.rotation, doubt, rng)
        estimate = from_rows(self._calibration, view, memory.estimate)
        return memory._replace(view=view if len(view.left) >= FEWEST else None, X_VC=np.eye(4), estimate=estimate)

    def _applied(self, memory: SelfCalibrationMemory[Memory]) -> SelfCalibrationMemory[Memory]:
        """Memory with its estimate applied, if the change is worth a restart of the odometry."""
        off = np.abs(memory.estimate.angles - memory.applied)
        worth = np.maximum(_WORTH_IT * _std(memory.estimate), _LEAST_WORTH)
        return memory._replace(applied=memory.estimate.rotation) if (off > worth).any() else memory

    def _message(self, motion: Motion, memory: SelfCalibrationMemory[Memory]) -> SelfCalibratedMotion:
        """Motion message with the uncertainty of the rotation."""
        std = _std(memory.estimate)
        doubt = float(np.hypot(std[1], memory.estimate.angles[1] - memory.applied.yaw))
        values = {field.name: getattr(motion, field.name) for field in fields(motion)}
        if motion.health is not Health.LOST:
            values["covariance"] = motion.covariance + self._from_doubt(motion.X_PC, doubt)
        if motion.anchor is not None:
            covariance = motion.anchor.covariance + self._from_doubt(motion.anchor.X_AC, doubt)
            values["anchor"] = replace(motion.anchor, covariance=covariance)
        return SelfCalibratedMotion(
            **values, right_rotation=memory.estimate.rotation, right_rotation_std=RightRotation(*std.tolist())
        )

    def _from_doubt(self, X: FloatArray, yaw_doubt: float) -> FloatArray:
        """Covariance (6, 6) of a motion from a yaw error, which scales all depths and so the translation.

        The scale error is constant over a trailer length, but errors of motions count as independent: hence the factor,
        the number of motions in that length.
        """
        depth, distance = _SEEN_DEPTH * float(self._calibration.X_SC[2, 3]), float(np.linalg.norm(X[:3, 3]))
        error = depth / self._calibration.baseline * yaw_doubt * X[:3, 3]
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = max(1.0, _CONSTANT_OVER / max(distance, _LEAST_DISTANCE)) * np.outer(error, error)
        return covariance


def _view_due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """True if the newest frame is far enough from the reference view, or nearly too far rotated."""
    apart = _APART if memory.estimate.covariance[1, 1] < _DOUBT**2 else _APART_IN_DOUBT
    shift, turn = memory.X_VC[:3, 3], rotation_vector(memory.X_VC[:3, :3])
    return bool(np.linalg.norm(shift) > apart or np.linalg.norm(turn) > _TURNED)


def _std(estimate: Estimate) -> FloatArray:
    """Standard deviations (3,) [rad], with the common error of all views."""
    std: FloatArray = np.sqrt(np.diag(estimate.covariance) + _SYSTEMATIC**2)
    return std
