"""State of the right camera's mount and clock, and its updates by single pairs and by pairs some metres apart.

Yaw changes the rows of a pair by x y, and so does an error of the lens distortion. That error is one more unknown, a
constant: at the start the rows tell yaw to a tenth of a degree only, and once motion has told it, the rows show any
change of it at once. The same holds for a displacement along the optical axis and the offset of a pair at rest.
"""

import math
from typing import NamedTuple

import numpy as np

from estimators.calibration.epipolar import EpipolarFit, RightRotation
from vehicle.frames import FloatArray, so3_exp

ROLL, YAW, PITCH, DELAY, LENS, OFFSET = range(6)
_PRIOR = np.concatenate([np.radians([0.5, 0.4, 0.5]), [0.02], np.radians([0.15]), [0.004]])
"""Standard deviations before the first pair: of angles of a mount that was knocked [rad], of the delay of cameras
without a trigger line [s], of the lens error as yaw (0.2 deg on KITTI's images) [rad], and of the offset along the
optical axis that a lens error imitates (5 mm there) [m]."""
_BENDS = np.concatenate([np.radians([0.002, 0.001, 0.002]), [0.0], np.radians([0.003]), [0.0002]])
"""Random walk over distance, 1 sigma: of a mount [rad/sqrt(m)]; of the lens error, as the scene changes."""
_DRIFT = (
    1e-5  # random walk of the delay over distance, 1 sigma: clocks drift by 1e-5, that is 1e-6 s a frame [s/sqrt(m)]
)
_NEIGHBOURS = 4.0  # factor on the variance of a fit for correlated errors of neighbours: measured on KITTI's images
_SINGLE = np.concatenate([np.radians([0.002, 0.01, 0.001]), [0.002]])  # error of a fit beyond its scatter [rad, m]
_FRESH = 1.0  # fits nearer to each other share their errors [m]
_TURN_UNKNOWN = np.array([0.02, 0.005, 0.02])  # change since the last motion: roll, yaw, pitch rate, 1 sigma [rad/s]
_SPEED_UNKNOWN = 0.2  # the same of the speed [m/s]
_SPEED_SHARE = 0.05  # the same, as a share of the speed
_ANY_TURN, _ANY_SPEED = np.array([0.03, 0.1, 0.03]), 15.0  # velocities before the first motion [rad/s, m/s]
_SURPRISE = 45.0  # squared normalised innovation of four values: one in 2e8 if all is as modelled
_EXPECTED = 18.5  # the same: exceeded once in a thousand


class Twist(NamedTuple):
    """Velocity of the left camera along its own axes."""

    turn: FloatArray  # (3,) [rad/s]
    velocity: FloatArray  # (3,) [m/s]
    doubt: float  # relative error of the velocity by an unknown delay, 1 sigma; infinite: there has been no motion yet

    @property
    def known(self) -> bool:
        """True if there has been a motion."""
        return math.isfinite(self.doubt)

    def of_right(self, baseline: float) -> FloatArray:
        """Velocity (3,) of the right camera [m/s]."""
        return self.velocity + baseline * np.array([0.0, self.turn[2], -self.turn[1]])


UNKNOWN = Twist(np.zeros(3), np.zeros(3), math.inf)


class MountState(NamedTuple):
    """Roll, yaw, pitch [rad], delay [s] of the right camera, lens error [rad] and offset [m], with their covariance."""

    mean: FloatArray  # (6,)
    covariance: FloatArray  # (6, 6)

    @property
    def rotation(self) -> RightRotation:
        """The angles by name."""
        return RightRotation(*self.mean[:3].tolist())

    @property
    def std(self) -> FloatArray:
        """Standard deviations (6,)."""
        return np.sqrt(np.diag(self.covariance))


def initial() -> MountState:
    """State before the first pair."""
    return MountState(np.zeros(6), np.diag(_PRIOR**2))


def carried(state: MountState, distance: float) -> MountState:
    """State after some distance [m]."""
    walk = _BENDS**2 * distance
    walk[DELAY] = _DRIFT**2 * distance
    return MountState(state.mean, state.covariance + np.diag(walk))


def reopened(state: MountState) -> MountState:
    """State of a mount that was knocked, or of cameras that lost their trigger; what is known of the lens remains."""
    wide = _PRIOR**2
    wide[[LENS, OFFSET]] = 0.0
    return MountState(state.mean, state.covariance + np.diag(wide))


def expected_fit(state: MountState, twist: Twist, baseline: float) -> FloatArray:
    """Roll, yaw, pitch [rad] and displacement along the optical axis [m] that a pair should show: (4,)."""
    return _by_state(twist, baseline) @ state.mean


def innovation(
    state: MountState, fit: EpipolarFit, twist: Twist, baseline: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Surprise of a pair: measured minus expected values (4,), derivative (4, 6), and noise (4, 4)."""
    H, delay = _by_state(twist, baseline), state.mean[DELAY] ** 2 + state.covariance[DELAY, DELAY]
    return fit.values - H @ state.mean, H, _noise(fit) + delay * _twist_variance(twist)


def is_surprising(state: MountState, innovated: tuple[FloatArray, FloatArray, FloatArray]) -> bool:
    """True if a pair does not belong to cameras in this state."""
    return _squared(state, innovated) > _SURPRISE


def is_expected(state: MountState, innovated: tuple[FloatArray, FloatArray, FloatArray]) -> bool:
    """True if a pair is what cameras in this state show."""
    return _squared(state, innovated) < _EXPECTED


def _squared(state: MountState, innovated: tuple[FloatArray, FloatArray, FloatArray]) -> float:
    """Squared normalised innovation."""
    r, H, noise = innovated
    return float(r @ np.linalg.solve(H @ state.covariance @ H.T + noise, r))


def with_fit(
    state: MountState, innovated: tuple[FloatArray, FloatArray, FloatArray], distance: float | None
) -> MountState:
    """State updated with a pair, ``distance`` [m] after the one before (None: there is none)."""
    r, H, noise = innovated
    if distance is not None:
        noise = noise * max(1.0, _FRESH / max(distance, 1e-3))
    gain = np.linalg.solve(H @ state.covariance @ H.T + noise, H @ state.covariance).T
    left = np.eye(6) - gain @ H
    return MountState(state.mean + gain @ r, left @ state.covariance @ left.T + gain @ noise @ gain.T)


def with_information(
    state: MountState, information: FloatArray, gradient: FloatArray, twist: Twist = UNKNOWN, delay: float = 0.0
) -> MountState:
    """State updated with information (3, 3) on the angles; ``gradient`` (3,) is that times (measured - mean).

    The angles were measured in pairs whose ``delay`` [s] was compensated, in a camera with this ``twist``: what is left
    of the delay turned the right camera on.
    """
    H = np.zeros((3, 6))
    H[:, :3], H[:, DELAY] = np.eye(3), twist.turn[[2, 1, 0]]
    gradient = gradient - information @ H[:, DELAY] * (state.mean[DELAY] - delay)
    # (P^-1 + H' I H)^-1 = (1 + P H' I H)^-1 P
    covariance = np.linalg.solve(np.eye(6) + state.covariance @ H.T @ information @ H, state.covariance)
    covariance = 0.5 * (covariance + covariance.T)
    return MountState(state.mean + covariance @ H.T @ gradient, covariance)


def _noise(fit: EpipolarFit) -> FloatArray:
    """Covariance (4, 4) of a fit."""
    return _NEIGHBOURS * fit.covariance + np.diag(_SINGLE**2)


def _twist_variance(twist: Twist) -> FloatArray:
    """Covariance (4, 4) of the rates of roll, yaw and pitch and of the speed along the optical axis at a pair."""
    turn, speed = _ANY_TURN, _ANY_SPEED
    if twist.known:
        turn = _TURN_UNKNOWN
        speed = _SPEED_UNKNOWN + math.hypot(_SPEED_SHARE, twist.doubt) * abs(float(twist.velocity[2]))
    return np.diag(np.square([*turn, speed]))


def _by_state(twist: Twist, baseline: float) -> FloatArray:
    """Derivative (4, 6) of the values of a pair by the state."""
    H = np.zeros((4, 6))
    H[0, ROLL] = H[1, YAW] = H[2, PITCH] = H[1, LENS] = H[3, OFFSET] = 1.0
    H[:3, DELAY] = twist.turn[[2, 1, 0]]
    H[3, DELAY] = twist.of_right(baseline)[2]
    return H


class PairGeometry(NamedTuple):
    """Attitude and position of the right camera at its exposure, for a state and a velocity."""

    R_delay: FloatArray  # (3, 3) rotation of the body over the delay
    shift: FloatArray | None  # (3,) of the right camera over the delay, along the axes of the left one [m]

    def attitude(self, rotation: RightRotation) -> FloatArray:
        """R_ClCr (3, 3) of a right camera that is turned by ``rotation`` on its mount."""
        return self.R_delay @ rotation.matrix()


def geometry(delay: float, twist: Twist, baseline: float) -> PairGeometry:
    """Geometry of a right camera that exposes late by ``delay`` [s]."""
    if delay == 0.0:
        return PairGeometry(np.eye(3), None)
    # constant velocity along the axes of the body, which turn: the chord is halfway between the axes before and after
    chord = so3_exp(0.5 * delay * twist.turn) @ twist.of_right(baseline)
    return PairGeometry(so3_exp(delay * twist.turn), delay * chord)
