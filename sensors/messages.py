"""Messages from sensors: frozen, stamped with the tick at which they were captured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

GreyImage = NDArray[np.uint8]  # (height, width), [v, u]
ColourImage = NDArray[np.uint8]  # (height, width, 3), RGB


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoFrame:
    """A rectified stereo pair, grey; row v of both images sees the same epipolar line."""

    tick: int
    left: GreyImage
    right: GreyImage
    colour: ColourImage | None = None  # what the left camera saw in colour, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyPose:
    """Pose of a vehicle's body from a reference unit (exact, or an RT3022-like one)."""

    tick: int
    X_WB: FloatArray  # (4, 4)


@dataclass(frozen=True, slots=True, kw_only=True)
class EgoState:
    """What a driver perceives of his own tractor: where it is on the road and how it moves (frame T)."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    v_x: float  # [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteerAngles:
    """Angle encoders on a unit's steered axles, front to rear."""

    tick: int
    angles: FloatArray  # (n,) [rad], + left
