"""Sensors on a trailer: their context, and opened sensors with schedule and calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.trailer import TrailerGeometry
from estimators.calibration.rectification import Rectifier
from scenarios.assembly.views import Views
from scenarios.options.scenario import Scenario
from scenarios.progress import Progress, no_progress
from sensors.camera.lens import RawStereoRig
from sensors.camera.rig import StereoCalibration
from sensors.context import TrailerSensorContext
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import StereoFrame
from sensors.sensor import Message, Sensor
from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth

# assumed: gyros and angle sensors send every 20 ms; processing a message takes as long
SIGNALS = Schedule.at_rate(50.0, latency=0.02)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountContext(TrailerSensorContext):
    """Context of the built-in sensors: they read the whole scenario."""

    views: Views
    nominal: Vehicle  # the data sheet of controllers and estimators
    scenario: Scenario
    trailer: TrailerGeometry
    signals: CombinationSensors  # of this trailer
    stream: Callable[[str], np.random.Generator]  # random stream of this trailer, by name
    keep_colour: bool = False  # frames carry the left camera's colour image
    progress: Progress = no_progress  # of a calibration with boards


@dataclass(frozen=True, slots=True, kw_only=True)
class Cameras:
    """Calibrations of a stereo pair."""

    calibrated: StereoCalibration | RawStereoRig  # of the images as sent
    calibration: StereoCalibration  # of the images that estimators receive
    rectifier: Rectifier | None = None  # from the former to the latter; None: they are equal
    epipolar: bool = True  # the optical axes are parallel, as a stereo odometry needs

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """The frame as estimators receive it."""
        return frame if self.rectifier is None else self.rectifier.step(frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedSensor:
    """A sensor that is ready to sample."""

    sensor: Sensor[Truth, Message]
    schedule: Schedule
    cameras: Cameras | None = None  # None: not a stereo pair


class ReferencePose:
    """Exact plan poses of the trailer, at the rate of the cameras."""

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Reference unit on the trailer."""
        height = context.nominal.units[context.unit].roll_axis_height
        return OpenedSensor(sensor=ExactPose(context.unit, height), schedule=context.schedule)


class SignalsOfCombination:
    """The combination's own sensors at 50 Hz: speed, steer and articulation angles, gyros."""

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Sensors of the combination, shared with the trailer's steering law."""
        return OpenedSensor(sensor=context.signals, schedule=SIGNALS)
