"""The closed loop: one mutable Session that samples, delivers, controls, logs and integrates, always in that order."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from controllers.driver import PERIOD as DRIVER_PERIOD
from controllers.driver import DriverCommand
from controllers.trailer import SteerCommand
from estimators.estimates import Motion, OffTracking
from estimators.viso_ot import VisoOtEstimate
from scenarios.assembly import Assembly
from scenarios.recording import Recorder
from scenarios.results import CameraFrame
from sensors.messages import BodyPose, SteerAngles, StereoFrame
from sensors.navigation import DriverPerception, SteerEncoders
from vehicle.clock import TICK, Pipe, Schedule, to_ticks
from vehicle.plant import DivergedError, VehicleCommand
from vehicle.truth import Truth

LOG_PERIOD = 10  # [ticks]
_CONTROL = Schedule(period=to_ticks(DRIVER_PERIOD, "control period"))  # driver and trailer steering alike
_JPEG_QUALITY = 90
_OVERTIME = 1.5  # a run that takes so much longer than its path at set speed has got stuck


@dataclass(slots=True)
class Stopwatch:
    """Wall time spent in the stages of the loop [s]."""

    physics: float = 0.0
    render: float = 0.0
    odometry: float = 0.0
    total: float = 0.0


@dataclass(frozen=True, slots=True)
class Row:
    """What was so and what was commanded at one tick."""

    truth: Truth
    driver: DriverCommand
    steering: SteerCommand


@dataclass(slots=True, kw_only=True)
class Session:
    """A run in progress: the only mutable object of the house."""

    parts: Assembly
    keep_frames: bool = False
    recorder: Recorder | None = None
    tick: int = 0
    outcome: str | None = None  # None while running
    rows: list[Row] = field(default_factory=list)
    estimates: list[tuple[OffTracking, Motion | None]] = field(default_factory=list)
    frames: list[CameraFrame] = field(default_factory=list)
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    _state: Any = None
    _pipe: Pipe[StereoFrame | BodyPose] = field(default_factory=Pipe)
    _source: Any = None
    _steering: Any = None
    _driver: Any = None
    _newest: OffTracking | None = None
    _command: VehicleCommand | None = None
    _driver_command: DriverCommand = DriverCommand(0.0, 0.0)
    _steer_command: SteerCommand | None = None
    _station: float = 0.0
    _hash: Any = field(default_factory=hashlib.sha256)
