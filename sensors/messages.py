"""Messages from sensors: frozen, stamped with the tick at which they were captured."""

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
    colour: ColourImage | None = None  # what the left camera saw in colour, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyPose:
    """Pose of a vehicle's body from a reference unit (exact, or an RT3022-like one)."""

    tick: int
    X_WB: FloatArray  # (4, 4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GnssIns:
    """What a GNSS-aided inertial unit U says of itself; W are the axes of its local map."""

    tick: int
    p_WU: FloatArray  # (3,) [m]
    v_WU: FloatArray  # (3,) along the axes of W [m/s]
    heading: float  # of its x axis, + to the left of W's x [rad]
    pitch: float  # + nose down [rad]
    roll: float  # + left side up [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class EgoState:
    """What a driver perceives: where his tractor is on the road, how it moves (frame T), and what it tows."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    v_x: float  # [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]
    articulation: tuple[float, ...] = ()  # (N-1,) at each hitch, in his mirrors [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CombinationSignals:
    """What the sensors of a combination of N units say for the steering of one of its trailers."""

    tick: int
    angles: FloatArray  # (n_steered,) encoders of that trailer's steered axles, front to rear, + left [rad]
    speed: float  # of the tractor's rear axle, from the wheels of its foremost steered one [m/s]
    steer: float  # road-wheel angle of that axle, + left [rad]
    articulation: FloatArray  # (N-1,) at each hitch, psi of the unit ahead less that of the unit behind [rad]
    yaw_rates: FloatArray  # (N,) gyros, tractor first [rad/s]
    lateral_acceleration: float  # accelerometer on the body above that trailer's axle group, + left [m/s2]


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
    """What a rover's encoders and compass say at one tick."""

    tick: int
    heading: float  # of the compass, in W, wrapped [rad]
    wheel_speeds: FloatArray  # (n,) of rotation, in the order of the rover's file [rad/s]
    steer: FloatArray  # (n,) + left [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipReading:
    """What an instrument without any error would say of a rover's slip."""

    tick: int
    slip_angle: float  # direction of travel of R's origin against the body's x axis, + left [rad]
    wheel_slip: float  # the same of the left rear wheel against its heading [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserFix:
    """Where a laser tracker beside the field sees the rover."""

    tick: int
    p_WR: FloatArray  # (3,) of R's origin [m]
