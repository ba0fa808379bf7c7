"""VISO-OT: off-tracking from a stereo pair on the trailer (de Saxe 2018, section 2).

The paper uses the cameras alone. Where the signals of the combination are known, they bridge outages of the cameras and
check their motions (``estimators.off_tracking.signal_fusion``); as long as the cameras work the estimates are the same.
"""

import math
from dataclasses import replace
from typing import ClassVar, Generic, Literal, NamedTuple, Self

from estimators.context import Memory, Odometry, TrailerContext
from estimators.estimates import Anchor, CameraOffTracking, Health, Motion
from estimators.off_tracking.buffer import REVERSING, BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.off_tracking.signal_fusion import FusionMemory, SignalFusion
from estimators.rigid_motion import change_frame
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame, TrailerView, stereo_frame
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray, raised
from vehicle.option import PartParameters, option, quantity


class VisoOtMemory(NamedTuple, Generic[Memory]):
    """Memories of odometry, buffer and fusion."""

    odometry: Memory
    buffer: BufferMemory
    fusion: FusionMemory | None = None  # None: there is no fusion


class VisoOt(Generic[Memory]):
    """VISO-OT: off-tracking from stereo frames by odometry, change to the trailer frame, and a path buffer."""

    sensor: ClassVar[str] = "stereo_camera"

    class Parameters(PartParameters):
        """The buffer, and the use of signals."""

        smoothing: bool = option("Smooth the motions in the buffer with a Kalman filter.", False)
        reversing_distance: float = quantity(
            REVERSING, "m", 0.0, 200.0, "Distance of reversing for which the path is kept."
        )
        fusion: Literal["signals", "none"] = option(
            "Bridge outages of the cameras, and check them, by the combination's own sensors; none: cameras alone.",
            "signals",
        )

    def __init__(
        self,
        calibration: StereoCalibration,
        follow_distance: float,
        odometry: Odometry[Memory],
        *,
        parameters: Parameters | None = None,
        path_height: float = 0.0,
        direction_std: float = 0.0,
        towed: tuple[Vehicle, int] | None = None,
    ) -> None:
        """For the rig of ``calibration`` and a follow point ``follow_distance`` [m] behind the hitch.

        Paths are those of points at ``path_height`` [m] in the body. At the height of its roll axis a body does not
        move to the side as it rolls. The direction of the left camera in the body is known to ``direction_std`` [rad],
        1 sigma: an error turns the path about the hitch. Fusion of signals needs to know the trailer as ``towed``: the
        vehicle and the number of its unit. Without it the cameras are used alone.

        Raises:
            ValueError: if ``follow_distance`` is not positive, or ``towed`` is no towed unit.
        """
        given = parameters or self.Parameters()
        self._X_SC = raised(-path_height) @ calibration.X_SC
        self._odometry = odometry
        self._direction_std = direction_std * follow_distance  # [m]
        self._buffer = OffTrackingBuffer(
            follow_distance, reversing_distance=given.reversing_distance, smoothing=given.smoothing
        )
        fuses = towed if given.fusion == "signals" else None
        self._fusion = None if fuses is None else SignalFusion(*fuses, follow_distance, self._buffer)
        self.fuses_signals = self._fusion is not None

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator with the context's cameras, odometry and options."""
        return cls(
            context.stereo(),
            context.follow_distance,
            context.stereo_odometry(),
            parameters=cls.Parameters.of(context.options, "estimator"),
            path_height=context.roll_axis_height,
            towed=(context.vehicle, context.unit) if context.unit > 0 else None,
        )

    def init(self) -> VisoOtMemory[Memory]:
        """Memory before the first frame."""
        fusion = None if self._fusion is None else self._fusion.init()
        return VisoOtMemory(self._odometry.init(), self._buffer.init(), fusion)

    def step(
        self, memory: VisoOtMemory[Memory], message: StereoFrame | TrailerView
    ) -> tuple[VisoOtMemory[Memory], CameraOffTracking | None]:
        """Memory with the message in it, and the off-tracking at its tick; None for the first one.

        Frames alone are used without fusion.
        """
        (odometry, buffer, fusion), frame = memory, stereo_frame(message)
        motion, off_tracking = None, None
        if frame is not None:
            odometry, motion = self._odometry.step(odometry, frame)
        body = None if motion is None else body_motion(self._X_SC, motion)
        if self._fusion is not None and fusion is not None and isinstance(message, TrailerView):
            fusion, buffer, off_tracking = self._fusion.step(fusion, buffer, message.tick, body, message.signals)
        elif body is not None:
            buffer, off_tracking = self._buffer.step(buffer, body)
        memory = VisoOtMemory(odometry, buffer, fusion)
        if off_tracking is None:
            return memory, None
        if self._direction_std > 0.0:
            off_tracking = replace(off_tracking, std=math.hypot(off_tracking.std, self._direction_std))
        return memory, CameraOffTracking(off_tracking=off_tracking, motion=motion)


def body_motion(X_SC: FloatArray, motion: Motion) -> BodyMotion:
    """Motion of the trailer body S from that of the camera at ``X_SC``: de Saxe 2018, eqs 1 and 2, in three dimensions.

    A lost motion stays lost, with its infinite covariance.
    """
    if motion.health is Health.LOST:
        return BodyMotion.lost(motion.tick, motion.previous_tick)
    body, anchor = change_frame(X_SC, motion.uncertain), motion.anchor
    if anchor is not None:
        X, covariance, common = change_frame(X_SC, anchor.uncertain)
        anchor = Anchor(tick=anchor.tick, X_AC=X, covariance=covariance, common=common)
    return BodyMotion(
        tick=motion.tick,
        previous_tick=motion.previous_tick,
        X_PC=body.X,
        covariance=body.covariance,
        health=motion.health,
        anchor=anchor,
        common=body.common,
    )
