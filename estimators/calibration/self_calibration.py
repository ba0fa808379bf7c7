"""Self-calibration online: an odometry that finds out how the right camera is turned, and straightens its images.

A mount that bends by a tenth of a degree biases the off-tracking by decimetres (de Saxe 2018, section 4.3). Here roll,
yaw and pitch are estimated all the time, slowly, as the mount may go on bending: roll and pitch from the rows of single
pairs, yaw from pairs some metres apart; the right image is straightened by them (eqs 8 and 9) before the odometry gets
it. Not modelled: a left camera that turns (to first order this looks the same), cameras that move along or apart.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Generic, NamedTuple

import numpy as np

from estimators.calibration.right_rotation import RightRotation, straightened
from estimators.calibration.rotation_fit import Estimate, from_motion, from_rows
from estimators.calibration.rotation_views import FEWEST, View, new_view, seen_again
from estimators.estimates import Health, Motion
from estimators.odometry.protocol import Odometry
from estimators.protocol import Memory
from estimators.rigid_motion import chained, rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray

_MOUNT = np.radians([0.1, 0.1, 0.1])  # what a mount is turned by before anything is known, 1 sigma: de Saxe 2018
_BENDS = np.radians([0.002, 0.001, 0.002])  # by which it goes on bending within a metre, 1 sigma [rad/sqrt(m)]
_SYSTEMATIC = np.radians([0.001, 0.001, 0.0005])  # what all views have in common: measured over rendered drives [rad]
_APART = 5.0  # of two views that yaw is measured from [m]
_APART_IN_DOUBT = 1.0  # the same as long as yaw is hardly known: a coarse value now is better than a fine one later [m]
_DOUBT = np.radians(0.01)  # of yaw; beyond, it costs 6 mm of off-tracking [rad]
_TURNED = np.radians(15.0)  # by which views may differ: beyond, few points are in both
_LEAST_APART = 0.9  # depth from parallax is too weak below [m]
_WORTH_IT = 1.5  # standard deviations that the images must be off by before they are straightened anew
_LEAST_WORTH = np.radians([0.005, 0.002, 0.005])  # costs less than 1 mm of off-tracking [rad]
_LEAST_WAY = 0.01  # shorter ways are a standstill [m]
_SEEN_DEPTH = 3.3  # depth of the points that decide on the motion, in camera heights
_ALIKE_OVER = 14.0  # way over which an error of the rotation stays the same, so that its effects add up linearly [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfCalibratedMotion(Motion):
    """A motion, and how the right camera was believed to be turned when it had been measured."""

    right_rotation: RightRotation  # [rad]
    right_rotation_std: RightRotation  # [rad]


class SelfCalibrationMemory(NamedTuple, Generic[Memory]):
    """The odometry's memory, the estimate, and the view that the next ones are compared with."""

    odometry: Memory
    estimate: Estimate
    applied: RightRotation  # that images are straightened by
    view: View | None = None
    X_VC: FloatArray = np.eye(4)  # of the newest frame in the view
    begun: bool = False  # whether the odometry has had a frame


class SelfCalibratedOdometry(Generic[Memory]):
    """Any odometry, given straightened images."""

    def __init__(self, calibration: StereoCalibration, odometry: Odometry[Memory], *, seed: int = 0) -> None:
        """An odometry around the given one; ``seed`` and a frame's tick fix all draws."""
        self._calibration, self._odometry, self._seed = calibration, odometry, seed

    def init(self) -> SelfCalibrationMemory[Memory]:
        """Memory before the first frame."""
        straight = RightRotation(0.0, 0.0, 0.0)
        return SelfCalibrationMemory(self._odometry.init(), Estimate(np.zeros(3), np.diag(_MOUNT**2)), straight)

    def step(
        self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame
    ) -> tuple[SelfCalibrationMemory[Memory], SelfCalibratedMotion | None]:
        """Memory with the frame in it, and the motion that ends at it; None for the first frame."""
        from_here = memory.view is None
        if from_here:
            memory = self._looked_at(memory, frame)
            memory = memory if memory.begun else self._applied(memory)
        odometry, motion = self._odometry.step(memory.odometry, self._straightened(frame, memory.applied))
        memory = memory._replace(odometry=odometry, begun=True)
        if motion is None:
            return memory, None
        if motion.health is Health.LOST:
            return memory._replace(view=None), self._message(motion, memory)
        memory = self._moved(memory, motion)
        if from_here:
            return memory._replace(X_VC=np.eye(4)), self._message(motion, memory)
        message = self._message(motion, memory)
        if not _due(memory):
            return memory, message
        memory = self._looked_at(self._compared(memory, frame), frame)
        again = self._applied(memory)
        if again.applied != memory.applied:  # what the odometry remembers was straightened otherwise
            odometry, _ = self._odometry.step(self._odometry.init(), self._straightened(frame, again.applied))
            again = again._replace(odometry=odometry)
        return again, message

    def _straightened(self, frame: StereoFrame, rotation: RightRotation) -> StereoFrame:
        if not any(rotation):
            return frame
        return replace(frame, right=straightened(self._calibration, frame.right, rotation))

    def _moved(self, memory: SelfCalibrationMemory[Memory], motion: Motion) -> SelfCalibrationMemory[Memory]:
        """The memory after the motion, over which the mount may have bent."""
        way = float(np.linalg.norm(motion.X_PC[:3, 3]))
        angles, covariance = memory.estimate
        estimate = Estimate(angles, covariance + np.diag(_BENDS**2 * way))
        return memory._replace(estimate=estimate, X_VC=chained(memory.X_VC, motion.X_PC))

    def _compared(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """The memory with what the frame and the view together tell."""
        if memory.view is None or np.linalg.norm(memory.X_VC[:3, 3]) < _LEAST_APART:
            return memory
        estimate = memory.estimate
        pairs = seen_again(self._calibration, memory.view, frame, memory.X_VC, estimate.rotation)
        found = from_motion(self._calibration, *pairs, memory.X_VC, estimate)
        return memory if found is None else memory._replace(estimate=found)

    def _looked_at(self, memory: SelfCalibrationMemory[Memory], frame: StereoFrame) -> SelfCalibrationMemory[Memory]:
        """The memory with the frame as its view, and what its rows tell."""
        rng = np.random.default_rng([self._seed, frame.tick, 2])
        doubt = float(np.sqrt(np.diag(memory.estimate.covariance)).max())
        view = new_view(self._calibration, frame, memory.estimate.rotation, doubt, rng)
        estimate = from_rows(self._calibration, view, memory.estimate)
        return memory._replace(view=view if len(view.left) >= FEWEST else None, X_VC=np.eye(4), estimate=estimate)

    def _applied(self, memory: SelfCalibrationMemory[Memory]) -> SelfCalibrationMemory[Memory]:
        """The memory with its estimate applied, if that is worth the odometry's new beginning."""
        off = np.abs(memory.estimate.angles - memory.applied)
        worth = np.maximum(_WORTH_IT * _std(memory.estimate), _LEAST_WORTH)
        return memory._replace(applied=memory.estimate.rotation) if (off > worth).any() else memory

    def _message(self, motion: Motion, memory: SelfCalibrationMemory[Memory]) -> SelfCalibratedMotion:
        """The motion, as uncertain as the rotation makes it."""
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
        """Covariance (6, 6) of a motion from a doubt about yaw: all depths, so the translation, wrong by one ratio.

        It is the same ratio over a trailer length, while errors of motions are taken to be independent: hence the
        factor of as many motions as make up that length.
        """
        depth, way = _SEEN_DEPTH * float(self._calibration.X_SC[2, 3]), float(np.linalg.norm(X[:3, 3]))
        error = depth / self._calibration.baseline * yaw_doubt * X[:3, 3]
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = max(1.0, _ALIKE_OVER / max(way, _LEAST_WAY)) * np.outer(error, error)
        return covariance


def _due(memory: SelfCalibrationMemory[Memory]) -> bool:
    """Whether the newest frame is far enough from the view, or turned so far that it will soon be too late."""
    apart = _APART if memory.estimate.covariance[1, 1] < _DOUBT**2 else _APART_IN_DOUBT
    way, turn = memory.X_VC[:3, 3], rotation_vector(memory.X_VC[:3, :3])
    return bool(np.linalg.norm(way) > apart or np.linalg.norm(turn) > _TURNED)


def _std(estimate: Estimate) -> FloatArray:
    """Standard deviations (3,) [rad], with what does not average out."""
    std: FloatArray = np.sqrt(np.diag(estimate.covariance) + _SYSTEMATIC**2)
    return std
