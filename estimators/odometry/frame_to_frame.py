"""Base of the odometries that compare each frame with the one before: it skips frames and checks motions."""

from abc import ABC, abstractmethod
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np

from estimators.context import above_ground
from estimators.estimates import Health, Motion, lost_motion
from estimators.odometry.covariance import SelfConsistency, stated
from estimators.odometry.plausibility import Belief, believed
from estimators.odometry.repeated_frames import is_repeated, visible_noise
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame

ENOUGH_MATCHES = 250  # with fewer matches errors grow: de Saxe 2018, section 3.2.1
LONGEST_SPAN = 500  # between two frames; after that a fast truck no longer sees the same ground [ticks]
_SHARED_VIEW = 5.0  # travel after which much of the ground in view is the same, 5 to 20 m from the camera [m]

Features = TypeVar("Features")
Seen: TypeAlias = tuple[StereoFrame, Features]


class FrameMemory(NamedTuple, Generic[Features]):
    """Last frame with its features, the motions before it, the camera's noise, and the filtered velocity."""

    frame: StereoFrame | None = None
    features: Features | None = None
    belief: Belief = Belief()
    noise: float = 0.0  # of the camera, once it was seen [grey levels]
    consistency: SelfConsistency = SelfConsistency()
    velocity: Any = None  # of an odometry that filters it


class FrameToFrame(ABC, Generic[Features]):
    """Stereo odometry from frame to frame."""

    def __init__(self, calibration: StereoCalibration, *, seed: int = 0) -> None:
        """An odometry for this rig; ``seed`` and a frame's tick fix the draws of RANSAC.

        Raises:
            ValueError: if the left camera is not above the ground.
        """
        self._calibration = above_ground(calibration)
        self._seed = seed

    def init(self) -> FrameMemory[Features]:
        """Memory before the first frame."""
        return FrameMemory()

    def step(self, memory: FrameMemory[Features], frame: StereoFrame) -> tuple[FrameMemory[Features], Motion | None]:
        """Memory with the frame in it, and the motion since the frame before; None for the first frame.

        A frame without texture (dark, blinded) is lost and skipped: the next motion starts again at the frame before,
        unless that is too old. A repeated frame is lost and skipped as well. After an implausible jump of velocity the
        odometry is lost until the next motion confirms it.
        """
        previous, before = memory.frame, memory.belief
        if previous is None or memory.features is None:
            return FrameMemory(frame, self._features(frame)), None
        if is_repeated(previous.left, frame.left, memory.noise, before.last):
            return memory, lost_motion(frame.tick, previous.tick)
        features = self._features(frame)
        measured = self._measured(memory, (previous, memory.features), (frame, features))
        if measured.health is Health.LOST and is_skipped(self._number(features), measured, before.newest):
            return memory, measured
        belief, motion = believed(before, measured)
        lost = motion.health is Health.LOST
        noise = memory.noise if lost or memory.noise else visible_noise(previous.left, frame.left)
        velocity, motion = (None, motion) if lost else self._filtered(memory.velocity, measured, motion)
        consistency, motion = stated(memory.consistency, motion, self._calibration.focal_length)
        return FrameMemory(frame, features, belief, noise, consistency, velocity), motion

    @abstractmethod
    def _features(self, frame: StereoFrame) -> Features:
        """Features of a frame."""

    @abstractmethod
    def _number(self, features: Features) -> int:
        """Number of features in the left image."""

    @abstractmethod
    def _measured(self, memory: FrameMemory[Features], previous: Seen[Features], current: Seen[Features]) -> Motion:
        """Motion from the previous to the current frame."""

    def _filtered(self, velocity: Any, measured: Motion, motion: Motion) -> tuple[Any, Motion]:
        """Velocity after a measured motion, and the motion to report for the one that is believed."""
        return velocity, motion


def is_skipped(corners: int, lost: Motion, last: Motion | None) -> bool:
    """True if a frame on which the odometry was lost is skipped: it has few corners, and the frame before is near.

    Near is what is recent, or what the last motion, continued, has left behind by a short way only.
    """
    ticks = lost.tick - lost.previous_tick
    if corners >= ENOUGH_MATCHES:
        return False
    if ticks < LONGEST_SPAN:
        return True
    if last is None:
        return False
    travel = np.linalg.norm(last.X_PC[:3, 3]) * ticks / (last.tick - last.previous_tick)
    return bool(travel < _SHARED_VIEW)
