"""Context that an estimator is constructed from: ``EstimatorClass.of(context)``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self, TypeAlias

import numpy as np

from estimators.estimates import CameraOffTracking, OffTracking, SlipAngle
from estimators.protocol import Estimator, Odometry
from estimators.rover_geometry import RoverGeometry
from sensors.camera.rig import StereoCalibration
from sensors.sand.trace_rig import TraceRig
from vehicle.combination.description import Vehicle
from vehicle.option import Option, Parameter


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
    options: ClassVar[tuple[Option, ...]]

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for one trailer.

        Raises:
            ValueError: one line, if the context does not fit.
        """


class SlipEstimator(Estimator[Any, Any, SlipAngle], Protocol):
    """Class of slip estimators, as the catalogue holds them; every message gets an estimate, LOST without a trace."""

    sensor: ClassVar[str]  # "trace_camera" or "slip_reading"
    options: ClassVar[tuple[Option, ...]]

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator for one rover.

        Raises:
            ValueError: one line, if the context does not fit.
        """

    def step(self, memory: Any, message: Any, /) -> tuple[Any, SlipAngle]:
        """Memory after the message, and the estimate at its tick."""
