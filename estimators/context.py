"""Interfaces of estimators, and the contexts from which they are constructed: ``EstimatorClass.of(context)``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self, TypeAlias, TypeVar, runtime_checkable

import numpy as np

from estimators.estimates import CameraOffTracking, Motion, OffTracking, SlipAngle
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray
from vehicle.option import Parameter
from vehicle.rover.command import WheelPlace

Memory = TypeVar("Memory")
MessageT_contra = TypeVar("MessageT_contra", contravariant=True)
EstimateT_co = TypeVar("EstimateT_co", covariant=True)


class Estimator(Protocol[Memory, MessageT_contra, EstimateT_co]):
    """Recursive estimator without hidden state: everything it remembers is in the memory passed in and returned."""

    def init(self) -> Memory:
        """Memory before the first message."""

    def step(self, memory: Memory, message: MessageT_contra, /) -> tuple[Memory, EstimateT_co | None]:
        """Memory after the message, and the estimate at its tick if there is a new one."""


@runtime_checkable
class FusesSignals(Protocol):
    """Declaration of an estimator of stereo frames that can use the signals of the combination as well."""

    fuses_signals: bool  # True: its messages are `sensors.messages.TrailerView` instead of `StereoFrame`


class Odometry(Estimator[Memory, StereoFrame, Motion], Protocol[Memory]):
    """Motion of the left camera from frame to frame, constructed from a `StereoCalibration`; None for the first."""


def above_ground(calibration: StereoCalibration) -> StereoCalibration:
    """Return the calibration if its left camera is above the ground.

    Raises:
        ValueError: if the left camera is not above the ground.
    """
    height = float(calibration.X_SC[2, 3])
    if not height > 0.0:
        raise ValueError(f"camera height X_SC[2, 3] = {height} m must be positive")
    return calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverGeometry:
    """Data sheet of a rover for its odometry and driver.

    Raises:
        ValueError: if a length is not positive.
    """

    wheels: tuple[WheelPlace, ...]
    wheel_radius: float  # [m]
    effective_track: float  # for turning by wheel speed differences: the tread times a factor for scrubbing [m]
    max_steer: tuple[float, ...]  # of each wheel; 0: it is not steered [rad]
    max_wheel_speed: float  # [rad/s]

    def __post_init__(self) -> None:
        for name in ("wheel_radius", "effective_track", "max_wheel_speed"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")
        if len(self.max_steer) != len(self.wheels):
            raise ValueError(f"max_steer = {self.max_steer} must have a value for each of {len(self.wheels)} wheels")

    @property
    def steered(self) -> bool:
        """True if any wheel is steered; otherwise the rover turns by wheel speed differences of its sides."""
        return max(self.max_steer) > 0.0

    def places(self) -> FloatArray:
        """Wheels (n, 2) in R [m], in their order."""
        return wheel_places(self.wheels)


def wheel_places(wheels: Sequence[WheelPlace]) -> FloatArray:
    """Places (n, 2) of wheels in R [m]."""
    return np.array([(wheel.x, wheel.y) for wheel in wheels])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrailerContext:
    """Everything that an off-tracking estimator may know before the run."""

    vehicle: Vehicle
    unit: int  # the trailer's index in the vehicle; the tractor is 0
    follow_distance: float  # hitch to follow point [m]
    calibration: StereoCalibration | None  # of the images it gets; None: its sensor is no stereo pair
    odometry: Odometry[Any] | None  # for these cameras; None: its sensor is no stereo camera
    rng: np.random.Generator  # the estimator's own stream
    options: Mapping[str, Parameter]  # by name; those not given keep their defaults
    sensor: object  # the opened sensor, for estimators of one's own sensors

    @property
    def roll_axis_height(self) -> float:
        """Height [m] of the axis about which the trailer's body rolls."""
        return self.vehicle.units[self.unit].roll_axis_height

    def stereo(self) -> StereoCalibration:
        """Calibration of the cameras.

        Raises:
            ValueError: if the sensor is no stereo pair.
        """
        if self.calibration is None:
            raise ValueError("this off-tracking estimator needs a calibrated stereo pair")
        return self.calibration

    def stereo_odometry(self) -> Odometry[Any]:
        """Odometry of the stereo camera.

        Raises:
            ValueError: if the sensor is no stereo camera.
        """
        if self.odometry is None:
            raise ValueError("this off-tracking estimator needs a stereo camera with an odometry")
        return self.odometry


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverContext:
    """Everything that a slip estimator may know before the run."""

    rover: RoverGeometry | None  # None: a recording, of which only the rig is known
    rig: TraceRig
    rng: np.random.Generator  # the estimator's own stream
    options: Mapping[str, Parameter]  # by name; those not given keep their defaults


OffTrackingSource: TypeAlias = Estimator[Any, Any, OffTracking | CameraOffTracking]
"""An off-tracking estimator that is ready for messages."""


class OffTrackingEstimator(OffTrackingSource, Protocol):
    """Class of off-tracking estimators, as the catalogue holds them."""

    sensor: ClassVar[str]  # name in the catalogue of sensors, or the import path of one's own

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for one trailer.

        Raises:
            ValueError: one line, if the context does not fit.
        """


class SlipEstimator(Estimator[Any, Any, SlipAngle], Protocol):
    """Class of slip estimators, as the catalogue holds them; every message gets an estimate, LOST without a trace."""

    sensor: ClassVar[str]  # "trace_camera" or "slip_reading"

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator for one rover.

        Raises:
            ValueError: one line, if the context does not fit.
        """

    def step(self, memory: Any, message: Any, /) -> tuple[Any, SlipAngle]:
        """Memory after the message, and the estimate at its tick."""
