"""Ground-watching off-tracking: the rear camera recognises ground that the front camera saw before.

Miao's system as de Saxe 2018, section 1.2, describes it. Two downward cameras sit under the trailer, one near the fifth
wheel and one near the follow point. The motion of the ground in both images between frames fills the buffer. When the
rear camera passes over ground that the front camera has seen, matching the two images gives the past pose of the
trailer in the current one, and with it the hitch's path at the follow point without drift. With one camera, or where
the rear camera sees other ground, the motion alone is used.

Assumed, as in the original: plane, rigid ground, and cameras at constant height and attitude.
"""

import math
from dataclasses import replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from estimators.context import TrailerContext
from estimators.estimates import CameraOffTracking, Health, Motion, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.off_tracking.ground_view import (
    GroundView,
    Pairs,
    ground_cameras,
    ground_motion,
    paired,
    planar_motion,
    viewed,
)
from estimators.off_tracking.pose_chain import Sample
from estimators.rigid_motion import UncertainMotion, change_frame, lasting, rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, inverse

_STILL = 5e-4  # below it the trailer stands: views are kept, so that noise does not accumulate [m]
_LONGEST_SPAN = 500  # longest loss; after it the views no longer overlap [ticks]
_OVERLAP = 0.75  # largest offset of two views, as a share of the image's length
_MISTAKEN = (0.5, math.radians(10.0))  # a closure this far from the prediction is a mistake [m, rad]
_TILT = 0.003  # error on the ground by 0.2 deg of roll between two views, camera 1 m above it, 1 sigma [m]
_DISAGREEING = 0.015  # of the cameras, for degraded health; level ground: below 1 mm, bad road: up to 8 mm [m]
_SUBSIDES = 0.9  # decay of the unrest per frame: a body sways for about a second
_LONGER = 2.0  # attitude change of views seconds apart over that of two frames, on a road of class C
_LASTS = 2.0  # distance for which a closure keeps the path accurate enough [m]


class Views(NamedTuple):
    """Views of both cameras at one time; without the rear one for a single camera."""

    front: GroundView
    rear: GroundView | None


class GroundMemory(NamedTuple):
    """Buffer, reference views and state of the closure."""

    buffer: BufferMemory
    tick: int = 0  # of the newest frame that was not lost
    views: Views | None = None  # of that frame, or of the last one before a standstill
    passed: tuple[tuple[int, GroundView], ...] = ()  # front views along the path, newest first
    heading: float = 0.0  # yaw of the trailer since the first frame [rad]
    yaw: float = 0.0  # yaw of the last motion, the guess for the next one [rad]
    since: float = math.inf  # distance since the last closure [m]
    unrest: float = 0.0  # recent disagreement of the cameras, as the body moves on its suspension [m]


class GroundWatching:
    """Off-tracking from two downward cameras under the trailer."""

    sensor: ClassVar[str] = "ground_cameras"
    _single = False

    def __init__(self, calibration: StereoCalibration, follow_distance: float) -> None:
        """For the cameras of ``calibration`` (left: front, right: rear) and a follow point behind the hitch [m].

        Raises:
            ValueError: if ``follow_distance`` is not positive, or the cameras do not look down at the ground.
        """
        self._cameras = ground_cameras(calibration)
        self._middles = tuple(camera.X_SC[:2, 3] for camera in self._cameras)
        self._X_SC = calibration.X_SC
        self._reach = _OVERLAP * calibration.width / calibration.focal_length * float(calibration.X_SC[2, 3])
        self._buffer = OffTrackingBuffer(follow_distance)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator with the context's cameras."""
        return cls(context.stereo(), context.follow_distance)

    def init(self) -> GroundMemory:
        """Memory before the first frame."""
        return GroundMemory(self._buffer.init())

    def step(self, memory: GroundMemory, frame: StereoFrame) -> tuple[GroundMemory, CameraOffTracking | None]:
        """Memory with the frame in it, and the off-tracking at its capture; None for the first frame."""
        (front, rear), heading = self._cameras, memory.heading + memory.yaw
        behind = None if self._single else viewed(rear, frame.right, heading)
        views = Views(viewed(front, frame.left, heading), behind)
        if memory.views is None:
            return memory._replace(tick=frame.tick, views=views, passed=((frame.tick, views.front),)), None
        matched = [paired(before, now) for before, now in zip(memory.views, views, strict=True) if before and now]
        usable = [(pairs, middle) for pairs, middle in zip(matched, self._middles, strict=False) if pairs.enough]
        if not usable:
            return self._lost(memory, frame.tick, views, matched)
        motion, disagreement = ground_motion(usable)
        still = float(np.linalg.norm(motion.X[:2, 3])) < _STILL
        agreed = len(usable) == len(matched) and disagreement < _DISAGREEING
        body = BodyMotion(
            tick=frame.tick,
            previous_tick=memory.tick,
            X_PC=np.eye(4) if still else motion.X,
            covariance=motion.covariance,
            health=Health.OK if agreed else Health.DEGRADED,
            common=lasting(motion.covariance, 0.2),
        )
        buffer, off_tracking = self._buffer.step(memory.buffer, body)
        unrest = max(disagreement, _SUBSIDES * memory.unrest)
        memory = _advanced(memory, frame.tick, views, body.X_PC)._replace(buffer=buffer, unrest=unrest)
        memory, off_tracking = self._closed(memory, views, off_tracking)
        return memory, CameraOffTracking(off_tracking=off_tracking, motion=self._message(body, matched))

    def _lost(
        self, memory: GroundMemory, tick: int, views: Views, matched: list[Pairs]
    ) -> tuple[GroundMemory, CameraOffTracking]:
        """Lost frame: it is skipped, or restarts the views after a long loss."""
        lost = BodyMotion.lost(tick, memory.tick)
        buffer, off_tracking = self._buffer.step(memory.buffer, lost)
        memory = memory._replace(buffer=buffer)
        if tick - memory.tick >= _LONGEST_SPAN:
            memory = memory._replace(tick=tick, views=views, yaw=0.0, since=math.inf)
        return memory, CameraOffTracking(off_tracking=off_tracking, motion=self._message(lost, matched))

    def _closed(
        self, memory: GroundMemory, views: Views, off_tracking: OffTracking
    ) -> tuple[GroundMemory, OffTracking]:
        """Buffer and off-tracking after a closure, if there is one."""
        samples = memory.buffer.samples
        closure = self._closure(samples, memory.passed, views.rear) if views.rear else None
        if closure is None:
            since = memory.since
            doubtful = not self._single and since > _LASTS and off_tracking.health is Health.OK
            return memory, replace(off_tracking, health=Health.DEGRADED) if doubtful else off_tracking
        attitude = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]) * (_TILT**2 + (_LONGER * memory.unrest) ** 2)
        index, X_CK = closure
        X_CK = X_CK._replace(covariance=X_CK.covariance + attitude)
        buffer, off_tracking = self._buffer.closed(memory.buffer, index, X_CK)
        return memory._replace(buffer=buffer, since=0.0), off_tracking

    def _closure(
        self, samples: tuple[Sample, ...], passed: tuple[tuple[int, GroundView], ...], rear: GroundView
    ) -> tuple[int, UncertainMotion] | None:
        """Index of a past sample and its pose X_CK now, by the rear view and the front view nearest to it then.

        None if no view is near, or the two do not match.
        """
        views = dict(passed)
        X_CW = inverse(samples[0].X_OS)
        front, rear_camera = (camera.X_SC[:3, 3] for camera in self._cameras)
        poses = {index: X_CW @ one.X_OS for index, one in enumerate(samples) if one.tick in views}  # X_CK
        distances = {k: float(np.linalg.norm((X @ [*front, 1.0])[:2] - rear_camera[:2])) for k, X in poses.items()}
        index = min(distances, key=distances.__getitem__, default=0)
        if index == 0 or distances[index] > self._reach:
            return None
        X_CK, pairs = poses[index], paired(rear, views[samples[index].tick])
        if not pairs.enough:
            return None
        measured = planar_motion(pairs)
        correction = measured.X @ inverse(X_CK)
        turn = abs(float(rotation_vector(correction[:3, :3])[2]))
        shift = float(np.linalg.norm(measured.X[:2, 3] - X_CK[:2, 3]))
        return None if shift > _MISTAKEN[0] or turn > _MISTAKEN[1] else (index, measured)

    def _message(self, body: BodyMotion, matched: list[Pairs]) -> Motion:
        """Motion of the front camera, for the log."""
        motion = body.uncertain
        if body.health is not Health.LOST:
            motion = change_frame(inverse(self._X_SC), motion)
        return Motion(
            tick=body.tick,
            previous_tick=body.previous_tick,
            X_PC=motion.X,
            covariance=motion.covariance,
            matches=sum(pairs.matches for pairs in matched),
            inliers=sum(len(pairs.first) for pairs in matched),
            health=body.health,
            tracks=np.column_stack([self._cameras[0].in_image(p_S) for p_S in matched[0][:2]]).astype(np.float32),
        )


class SingleGroundWatching(GroundWatching):
    """Ground-watching with the front camera alone, by its motion without closure."""

    _single = True


def _advanced(memory: GroundMemory, tick: int, views: Views, X_PC: FloatArray) -> GroundMemory:
    """Memory advanced to the new frame; at standstill the views are kept."""
    distance = float(np.linalg.norm(X_PC[:2, 3]))
    if distance == 0.0:
        return memory._replace(tick=tick, yaw=0.0)
    yaw = math.atan2(X_PC[1, 0], X_PC[0, 0])
    oldest = memory.buffer.samples[-1].tick if memory.buffer.samples else tick
    passed = ((tick, views.front), *(item for item in memory.passed if item[0] >= oldest))
    return memory._replace(
        tick=tick, views=views, passed=passed, heading=memory.heading + yaw, yaw=yaw, since=memory.since + distance
    )
