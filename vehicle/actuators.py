"""Actuators: first-order lag with limits on value and rate. Every function takes numbers or ``casadi.SX``."""

from __future__ import annotations

import casadi as ca

from vehicle.tyres import Num


def limited(value: Num, low: float, high: float) -> Num:
    """The value clipped to [low, high]."""
    return ca.fmax(low, ca.fmin(high, value))


def steer_rate(angle: Num, demand: Num, *, lag: float, limit: float, rate_limit: float) -> Num:
    """Rate [rad/s] of a road-wheel angle [rad] that follows a demand [rad] within its limits."""
    return limited((limited(demand, -limit, limit) - angle) / lag, -rate_limit, rate_limit)


def demand_rate(acceleration: Num, demand: Num, *, lag: Num, braking: float, driving: float) -> Num:
    """Rate [m/s3] of the acceleration that drive and brake torques produce, which lags a demand [m/s2]."""
    return (limited(demand, -braking, driving) - acceleration) / lag
