"""Messages of sensors: frozen dataclasses stamped with the tick of their capture.

A message class with images names their fields in ``IMAGES``, a stereo pair left first (see ``sensors.sensor``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

GreyImage = NDArray[np.uint8]  # (height, width), [v, u]
ColourImage = NDArray[np.uint8]  # (height, width, 3), RGB
NearnessImage = NDArray[np.float32]  # (height, width) inverse depth along the optical axis [1/m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoFrame:
    """A stereo pair, grey. Once rectified, row v of both images sees the same epipolar line."""

    IMAGES: ClassVar[tuple[str, ...]] = ("left", "right")

    tick: int
    left: GreyImage
    right: GreyImage
    colour: ColourImage | None = None  # of the left camera, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyPose:
    """Pose of a vehicle's unit, from an exact reference unit or one like the RT3022."""

    tick: int
    X_WB: FloatArray  # (4, 4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GnssIns:
    """Position, velocity and attitude of a GNSS-aided inertial unit U; W is its local map."""

    tick: int
    p_WU: FloatArray  # (3,) [m]
    v_WU: FloatArray  # (3,) along the axes of W [m/s]
    heading: float  # of its x axis, + to the left of W's x [rad]
    pitch: float  # + nose down [rad]
    roll: float  # + left side up [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class EgoState:
    """State as perceived by the driver: pose and velocity of the tractor (frame T), articulation angles."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    v_x: float  # [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]
    articulation: tuple[float, ...] = ()  # (N-1,) at each hitch, seen in the mirrors [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CombinationSignals:
    """Signals of a combination of N units for the steering of one of its trailers."""

    tick: int
    angles: FloatArray  # (n_steered,) encoders of that trailer's steered axles, front to rear, + left [rad]
    speed: float  # of the tractor's rear axle, from the wheel speeds of its foremost steered axle [m/s]
    steer: float  # road-wheel angle of that axle, + left [rad]
    articulation: FloatArray  # (N-1,) at each hitch: psi of the unit ahead minus psi of the unit behind [rad]
    yaw_rates: FloatArray  # (N,) gyros, tractor first [rad/s]
    lateral_acceleration: float  # accelerometer on the body above that trailer's axle group, + left [m/s2]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrailerView:
    """Stereo frame of a trailer with the signals of the combination since the view before."""

    tick: int  # at which the frame was due
    frame: StereoFrame | None  # may have an older tick; None: none arrived
    signals: tuple[CombinationSignals, ...]  # oldest first


def stereo_frame(message: object) -> StereoFrame | None:
    """The stereo frame of a message, alone or with signals; None if it has none."""
    frame = message.frame if isinstance(message, TrailerView) else message
    return frame if isinstance(frame, StereoFrame) else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverView:
    """Ground image, encoders and compass of a rover at one tick: the input of slip estimation."""

    IMAGES: ClassVar[tuple[str, ...]] = ("image",)

    tick: int
    image: GreyImage  # of the ground behind the left rear wheel
    heading: float  # of the compass, in W, wrapped [rad]
    wheel_speeds: FloatArray  # (n,) of rotation, by the encoders, in the order of the rover's file [rad/s]
    steer: FloatArray  # (n,) by the encoders, + left [rad]
    colour: ColourImage | None = None  # the image in colour, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverReadings:
    """Readings of a rover's encoders and compass at one tick."""

    tick: int
    heading: float  # of the compass, in W, wrapped [rad]
    wheel_speeds: FloatArray  # (n,) of rotation, in the order of the rover's file [rad/s]
    steer: FloatArray  # (n,) + left [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipReading:
    """Exact slip of a rover, as an ideal instrument would measure it."""

    tick: int
    slip_angle: float  # direction of travel of R's origin against the body's x axis, + left [rad]
    wheel_slip: float  # of the left rear wheel: direction of travel against its heading [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserFix:
    """Position of the rover, measured by a laser tracker on the ground."""

    tick: int
    p_WR: FloatArray  # (3,) of R's origin [m]
