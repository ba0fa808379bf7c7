"""Faults at work (``sensors.faults.fault`` lists them): wrappers with the same ``sample(truth)`` around a sensor."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Protocol

import cv2
import numpy as np

from sensors.camera.lens import mount_rotation
from sensors.camera.lens_map import Floats
from sensors.camera.lens_surface import crusted, dirtied, veil_of_light
from sensors.camera.rig import StereoCalibration
from sensors.camera.shutter import STILL, Twist, moved, twist_between
from sensors.faults.fault import Fault
from sensors.messages import BodyPose, CombinationSignals, GreyImage, StereoFrame
from vehicle.clock import TICK, to_ticks
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

Message = StereoFrame | BodyPose | CombinationSignals


class Sensor(Protocol):
    """Whatever samples the truth; None: nothing arrives."""

    def sample(self, truth: Truth) -> Message | None:
        """The message of this moment."""


def faulty(
    sensor: Sensor, fault: Fault, *, unit: int, calibration: StereoCalibration | None, rng: np.random.Generator
) -> Sensor:
    """The sensor with a fault.

    Args:
        sensor: may be faulty already.
        fault: what befalls it.
        unit: of the vehicle that carries the sensor.
        calibration: of the cameras; None if it is no pair of cameras.
        rng: decides what is left to chance.

    Raises:
        ValueError: if a fault of cameras is to befall something else.
    """
    if fault.kind in ("dropout", "duplicate", "freeze"):
        return Repeating(sensor, fault, rng)
    if fault.kind == "delay":
        return Delayed(sensor, fault)
    if calibration is None:
        raise ValueError(f"fault {fault.kind}: the off-tracking is not estimated from cameras here")
    if fault.kind == "desync":
        return Desynchronised(sensor, fault, unit)
    return Spoilt(sensor, fault, calibration, rng)


class Repeating:
    """Messages that are lost, or replaced by the one before."""

    def __init__(self, sensor: Sensor, fault: Fault, rng: np.random.Generator) -> None:
        self._sensor, self._fault, self._rng = sensor, fault, rng
        self._share = 1.0 if fault.kind == "freeze" else fault.amounts[0]
        self._last: Message | None = None

    def sample(self, truth: Truth) -> Message | None:
        """The message of this tick, or what takes its place."""
        message = self._sensor.sample(truth)
        befallen = self._rng.random() < self._share and self._fault.at(truth.tick)
        if befallen and self._fault.kind == "dropout":
            return None
        if befallen and self._last is not None:
            return replace(self._last, tick=truth.tick)
        self._last = message
        return message


class Delayed:
    """Messages that arrive some captures late, stamped with when they were captured."""

    def __init__(self, sensor: Sensor, fault: Fault) -> None:
        self._sensor, self._fault = sensor, fault
        self._waiting: deque[Message | None] = deque()

    def sample(self, truth: Truth) -> Message | None:
        """The message that arrives now; when the fault is over those still under way are lost."""
        message = self._sensor.sample(truth)
        if not self._fault.at(truth.tick):
            self._waiting.clear()
            return message
        self._waiting.append(message)
        return self._waiting.popleft() if len(self._waiting) > self._fault.amounts[0] else None


class Desynchronised:
    """A stereo pair whose right image shows a moment later: where the body's steady motion will have taken it."""

    def __init__(self, sensor: Sensor, fault: Fault, unit: int) -> None:
        self._sensor, self._fault, self._unit = sensor, fault, unit
        self._before: tuple[int, FloatArray] | None = None

    def sample(self, truth: Truth) -> Message | None:
        """The pair of this tick."""
        twist = self._twist(truth)
        message = self._sensor.sample(truth)
        if not self._fault.at(truth.tick) or not isinstance(message, StereoFrame):
            return message
        bodies = truth.bodies.copy()
        lag = to_ticks(self._fault.amounts[0], "desync: amount")
        bodies[self._unit] = moved(bodies[self._unit], twist, lag * TICK)
        later = self._sensor.sample(replace(truth, tick=truth.tick + lag, bodies=bodies))
        return replace(message, right=later.right) if isinstance(later, StereoFrame) else None

    def _twist(self, truth: Truth) -> Twist:
        before, X_WB = self._before, truth.bodies[self._unit]
        self._before = truth.tick, X_WB
        return twist_between(before[1], X_WB, (truth.tick - before[0]) * TICK) if before else STILL


class Spoilt:
    """Stereo images that something has happened to; people see the spoilt image, too."""

    def __init__(self, sensor: Sensor, fault: Fault, calibration: StereoCalibration, rng: np.random.Generator) -> None:
        self._sensor, self._fault = sensor, fault
        shape = calibration.height, calibration.width
        if fault.kind == "dirt":
            self._layers: tuple[Floats, ...] = tuple(crusted(rng, shape, fault.amounts[0]) for _ in range(2))
        elif fault.kind == "glare":
            self._layers = (_glare(calibration, rng, fault.amounts[0]),) * 2
        elif fault.kind == "decalibration":
            self._H = _knocked(calibration, np.radians(fault.amounts))

    def sample(self, truth: Truth) -> Message | None:
        """The message of this tick."""
        message = self._sensor.sample(truth)
        if not self._fault.at(truth.tick) or not isinstance(message, StereoFrame):
            return message
        left, right = (self._spoilt(side, image) for side, image in enumerate((message.left, message.right)))
        return replace(message, left=left, right=right, colour=None)

    def _spoilt(self, side: int, image: GreyImage) -> GreyImage:
        match self._fault.kind:
            case "dirt":
                return dirtied(image, self._layers[side])
            case "glare":
                return np.asarray(cv2.add(image, self._layers[side], dtype=cv2.CV_8U), dtype=np.uint8)
            case "decalibration":
                return image if side == 0 else _warped(image, self._H)
            case _:
                return np.zeros_like(image)


def _glare(calibration: StereoCalibration, rng: np.random.Generator, strength: float) -> Floats:
    """A veil [grey levels] around a sun somewhere in the upper half of the image."""
    c = calibration
    u0, v0 = rng.uniform(0.1, 0.9) * c.width, rng.uniform(0.0, 0.4) * c.height
    v, u = np.mgrid[0 : c.height, 0 : c.width].astype(np.float32)
    angle = np.arctan(np.hypot(u - np.float32(u0), v - np.float32(v0)) / np.float32(c.focal_length))
    return veil_of_light(angle, strength)


def _knocked(calibration: StereoCalibration, angles: FloatArray) -> FloatArray:
    """The homography (3, 3) from the image of the straight camera to that of the turned one; exact for a pinhole."""
    c = calibration
    K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
    H: FloatArray = K @ mount_rotation(*angles).T @ np.linalg.inv(K)
    return H


def _warped(image: GreyImage, H: FloatArray) -> GreyImage:
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpPerspective(image, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.uint8)
