"""Slip angle of the body from the slip angle of a wheel: eq. 2 of Reina 2008.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import wrap

_SPAN: Final = 4.0  # of headings for the yaw rate: noise of 0.35 deg then gives 0.07 deg/s [s]; assumed
_SHORTEST: Final = 2.0  # with a shorter span the compass noise is worse than no rate [s]
_STATIONS: Final = 25  # samples of the steer angle along a trace: every 0.02 m of a view
_STANDING: Final = 0.01  # below it a trace says nothing about the current slip [m/s]


class Heading(NamedTuple):
    """Compass reading, unwrapped."""

    time: float  # [s]
    psi: float  # [rad]


def with_heading(headings: tuple[Heading, ...], view: RoverView) -> tuple[Heading, ...]:
    """Headings of the last seconds, including that of the view."""
    time = view.tick * TICK
    psi = headings[-1].psi + wrap(view.heading - headings[-1].psi) if headings else view.heading
    return (*(heading for heading in headings if heading.time > time - _SPAN), Heading(time, psi))


class Pointing(NamedTuple):
    """Steer angle of a wheel after a rolled distance."""

    distance: float  # [m]
    tick: int
    steer: float  # relative to the body, + left [rad]


def with_pointing(pointings: tuple[Pointing, ...], view: RoverView, rig: TraceRig, kept: float) -> tuple[Pointing, ...]:
    """Steer angles of the watched wheel over the last ``kept`` [m], including that of the view, by its encoders."""
    distance = 0.0
    if pointings:
        last = pointings[-1]
        rim_speed = rig.wheel_radius * abs(float(view.wheel_speeds[rig.watched]))
        distance = last.distance + rim_speed * (view.tick - last.tick) * TICK
    new = Pointing(distance, view.tick, float(view.steer[rig.watched]))
    return (*(one for one in pointings if one.distance > distance - kept), new)


def mean_steer(pointings: Sequence[Pointing], nearest: float, farthest: float) -> float:
    """Mean steer angle [rad] of a wheel while it made the trace ``nearest`` to ``farthest`` behind it [m].

    Before the first known angle, that angle is used.
    """
    behind = np.linspace(nearest, farthest, _STATIONS)
    distance, _, steer = np.array(pointings).T
    return float(np.interp(distance[-1] - behind, distance, steer).mean())


def rate_of_turn(headings: Sequence[Heading]) -> float:
    """Yaw rate [rad/s] by regression of the compass headings; 0 before there are enough."""
    time, psi = np.array(headings).T
    if time[-1] - time[0] < _SHORTEST:
        return 0.0
    away = time - time.mean()
    return float(away @ psi / (away @ away))


def forward_speed(view: RoverView, wheel_radius: float) -> float:
    """Speed of the body along its x axis by the encoders, without slip [m/s]."""
    return wheel_radius * float(np.mean(view.wheel_speeds * np.cos(view.steer)))


def body_slip(wheel_slip: float, steer: float, speed: float, rate: float, behind: float) -> float:
    """Slip angle beta [rad] of a body whose rear axle lies ``behind`` its centre of mass [m] (Reina 2008, eq. 2).

    ``wheel_slip`` alpha_r is the direction of the rear wheel's travel relative to its heading, ``steer`` delta_r that
    heading relative to the body, both + left; their sum is the direction of travel in the body. (The paper writes
    alpha_r - delta_r: one of the two has the opposite sign there.) ``rate`` is r [rad/s], ``speed`` V_x [m/s]. At very
    low speed R = V_x / r is undefined, and b / R is left out.
    """
    turning = behind * rate / speed if abs(speed) > _STANDING else 0.0
    return math.atan(math.tan(wheel_slip + steer) + turning)
