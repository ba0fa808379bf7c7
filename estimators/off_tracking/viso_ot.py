"""VISO-OT: off-tracking from a stereo pair on the trailer alone (de Saxe 2018, section 2).

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.
"""

from __future__ import annotations

from typing import ClassVar, Generic, NamedTuple, Self

from estimators.context import TrailerContext
from estimators.estimates import Anchor, CameraOffTracking, Health, Motion
from estimators.off_tracking.buffer import REVERSING, BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.protocol import Memory, Odometry
from estimators.rigid_motion import UncertainMotion, change_frame
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, raised
from vehicle.option import Option, option_values


class VisoOtMemory(NamedTuple, Generic[Memory]):
    """Memories of odometry and buffer."""

    odometry: Memory
    buffer: BufferMemory


class VisoOt(Generic[Memory]):
    """VISO-OT: off-tracking from stereo frames by odometry, change to the trailer frame, and a path buffer."""

    sensor: ClassVar[str] = "stereo_camera"
    options: ClassVar[tuple[Option, ...]] = (
        Option(name="smoothing", default=False, meaning="Kalman filter on the motions that fill the path buffer"),
        Option(
            name="reversing_distance",
            default=REVERSING,
            unit="m",
            low=0.0,
            high=200.0,
            meaning="path kept behind the follow point for a trailer that reverses",
        ),
    )

    def __init__(
        self,
        calibration: StereoCalibration,
        follow_distance: float,
        odometry: Odometry[Memory],
        *,
        reversing_distance: float = REVERSING,
        smoothing: bool = False,
        path_height: float = 0.0,
    ) -> None:
        """For the rig of ``calibration`` and a follow point ``follow_distance`` [m] behind the hitch.

        Paths are those of points at ``path_height`` [m] in the body. At the height of its roll axis a body does not
        move to the side as it rolls. The other options are those of `OffTrackingBuffer`.

        Raises:
            ValueError: if ``follow_distance`` is not positive, or ``reversing_distance`` [m] negative.
        """
        self._X_SC = raised(-path_height) @ calibration.X_SC
        self._odometry = odometry
        self._buffer = OffTrackingBuffer(follow_distance, reversing_distance=reversing_distance, smoothing=smoothing)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator with the context's cameras, odometry and options."""
        values = option_values(cls.options, context.options, "estimator")
        return cls(
            context.stereo(),
            context.follow_distance,
            context.stereo_odometry(),
            reversing_distance=float(values["reversing_distance"]),
            smoothing=bool(values["smoothing"]),
            path_height=context.roll_axis_height,
        )

    def init(self) -> VisoOtMemory[Memory]:
        """Memory before the first frame."""
        return VisoOtMemory(self._odometry.init(), self._buffer.init())

    def step(
        self, memory: VisoOtMemory[Memory], frame: StereoFrame
    ) -> tuple[VisoOtMemory[Memory], CameraOffTracking | None]:
        """Memory with the frame in it, and the off-tracking at its capture; None for the first frame."""
        odometry, motion = self._odometry.step(memory.odometry, frame)
        if motion is None:
            return VisoOtMemory(odometry, memory.buffer), None
        buffer, off_tracking = self._buffer.step(memory.buffer, body_motion(self._X_SC, motion))
        return VisoOtMemory(odometry, buffer), CameraOffTracking(off_tracking=off_tracking, motion=motion)


def body_motion(X_SC: FloatArray, motion: Motion) -> BodyMotion:
    """Motion of the trailer body S from that of the camera at ``X_SC``: de Saxe 2018, eqs 1 and 2, in three dimensions.

    A lost motion stays lost, with its infinite covariance.
    """
    body, anchor = UncertainMotion(motion.X_PC, motion.covariance), None
    if motion.health is not Health.LOST:
        body = change_frame(X_SC, body)
    if motion.anchor is not None:
        measured = change_frame(X_SC, UncertainMotion(motion.anchor.X_AC, motion.anchor.covariance))
        anchor = Anchor(tick=motion.anchor.tick, X_AC=measured.X, covariance=measured.covariance)
    return BodyMotion(
        tick=motion.tick,
        previous_tick=motion.previous_tick,
        X_PC=body.X,
        covariance=body.covariance,
        health=motion.health,
        anchor=anchor,
    )
