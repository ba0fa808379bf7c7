"""A drive of a tractor with one trailer by kinematics alone: poses of the trailer, its signals and exact motions."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.estimates import Health
from estimators.off_tracking.buffer import BodyMotion
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from tests.trailers import signals as readings
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

VEHICLE = load_vehicle("uk_longer_semitrailer")
HITCH = VEHICLE.units[0].rear_hitch[0]
FRONT = VEHICLE.units[0].steered_axles[0].x
FOLLOW, AXLE = 14.0, TyreScrub(VEHICLE, 1).axle_distance  # hitch to follow point and to the trailer's axles [m]
SIGNAL, FRAME = 20, 100  # periods [ticks]
STEP = 5  # of the integration [ticks]


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Constant errors of the signals."""

    scale: float = 0.0
    gyro: float = 0.0  # [rad/s]
    articulation: float = 0.0  # [rad]
    noise: float = 0.0  # 1: as of the sensors of a truck


@dataclass(frozen=True, slots=True, kw_only=True)
class TowedDrive:
    """Signals every 20 ms and poses every 100 ms."""

    signals: tuple[CombinationSignals, ...]
    bodies: dict[int, FloatArray]  # (4, 4) of the trailer's hitch, by tick

    def between(self, since: int, until: int) -> tuple[CombinationSignals, ...]:
        """Signals after one tick and up to another."""
        return tuple(message for message in self.signals if since < message.tick <= until)

    def motion(self, since: int, until: int, std: float = 1e-3) -> BodyMotion:
        """Exact motion between two frames, with a stated standard deviation [m], and of 0.05 of it in yaw [rad/m]."""
        errors = np.diag([0.05 * std] * 3 + [std] * 3)
        return BodyMotion(
            tick=until,
            previous_tick=since,
            X_PC=inverse(self.bodies[since]) @ self.bodies[until],
            covariance=errors**2,
            health=Health.OK,
            common=np.hstack([0.2 * errors, np.zeros((6, 7))]),  # as odometries from frame to frame state it
        )


def towed_drive(
    duration: float,
    speed: Callable[[float], float],
    yaw_rate: Callable[[float], float],
    slip: Callable[[float], float] = lambda t: 0.0,
    errors: Errors = Errors(),
    seed: int = 0,
) -> TowedDrive:
    """Drive for some seconds with these speeds [m/s], yaw rates [rad/s] and slip angles [rad] of the rear axle.

    The tractor's front wheels and the trailer's axles roll without slip.
    """
    rng = np.random.default_rng(seed)
    heading, x, y, gamma = 0.0, 0.0, 0.0, 0.0  # heading of the trailer, position of the hitch, articulation
    signals, bodies = [], {}
    for tick in range(0, round(duration / TICK) + 1, STEP):
        t = tick * TICK
        v, r = speed(t), yaw_rate(t)
        v_y = v * math.tan(slip(t)) + r * HITCH
        along = math.cos(gamma) * v - math.sin(gamma) * v_y
        across = math.sin(gamma) * v + math.cos(gamma) * v_y
        turn = across / AXLE  # the axle rolls without slip
        if tick % SIGNAL == 0:
            e = errors.noise * rng.standard_normal(4) * [0.02, *np.radians([0.15, 0.1, 0.1])]
            signals.append(
                readings(
                    tick,
                    speed=v * (1.0 + errors.scale) + float(e[0]),
                    steer=math.atan(math.tan(slip(t)) + r * FRONT / v) if v else 0.0,
                    articulation=np.array([gamma + errors.articulation + e[1]]),
                    yaw_rates=np.array([r + e[2], turn + errors.gyro + e[3]]),
                    lateral_acceleration=along * turn,
                )
            )
        if tick % FRAME == 0:
            bodies[tick] = transform(rotation_zyx(heading, 0.0, 0.0), np.array([x, y, 0.0]))
        dt = STEP * TICK
        c, s = math.cos(heading + 0.5 * turn * dt), math.sin(heading + 0.5 * turn * dt)
        x, y = x + dt * (c * along - s * across), y + dt * (s * along + c * across)
        heading, gamma = heading + turn * dt, gamma + (r - turn) * dt
    return TowedDrive(signals=tuple(signals), bodies=bodies)
