"""From a wheel's slip to that of the body: eq. 2 of Reina 2008.

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

_SPAN: Final = 4.0  # of headings that a rate of turn is fitted to: 0.35 deg of noise leave 0.07 deg/s [s]; assumed
_SHORTEST: Final = 2.0  # below this the noise of the compass is worse than no rate at all [s]
_STATIONS: Final = 25  # along a trace at which its wheel's angle is looked up: every 0.02 m of a view
_STANDING: Final = 0.01  # slower than this a trace says nothing about now [m/s]


class Heading(NamedTuple):
    """A reading of the compass, continuous."""

    time: float  # [s]
    psi: float  # [rad]


def with_heading(headings: tuple[Heading, ...], view: RoverView) -> tuple[Heading, ...]:
    """The headings of the last seconds with that of the view in them."""
    time = view.tick * TICK
    psi = headings[-1].psi + wrap(view.heading - headings[-1].psi) if headings else view.heading
    return (*(heading for heading in headings if heading.time > time - _SPAN), Heading(time, psi))


class Pointing(NamedTuple):
    """Where a wheel pointed when it had rolled so far."""

    way: float  # [m]
    tick: int
    steer: float  # against the body, + left [rad]


def with_pointing(pointings: tuple[Pointing, ...], view: RoverView, rig: TraceRig, kept: float) -> tuple[Pointing, ...]:
    """The watched wheel's pointings over the way that is ``kept`` [m], and that of the view, by its encoders."""
    way = 0.0
    if pointings:
        last = pointings[-1]
        way = last.way + rig.wheel_radius * abs(float(view.wheel_speeds[rig.watched])) * (view.tick - last.tick) * TICK
    new = Pointing(way, view.tick, float(view.steer[rig.watched]))
    return (*(one for one in pointings if one.way > way - kept), new)


def mean_steer(pointings: Sequence[Pointing], nearest: float, farthest: float) -> float:
    """How a wheel pointed on average while it made the trace that lies so far behind it [m]; [rad].

    A way that began later is taken to have begun as it is known first.
    """
    behind = np.linspace(nearest, farthest, _STATIONS)
    way, _, steer = np.array(pointings).T
    return float(np.interp(way[-1] - behind, way, steer).mean())


def rate_of_turn(headings: Sequence[Heading]) -> float:
    """Slope of the compass's headings [rad/s]; 0 before there are enough of them."""
    time, psi = np.array(headings).T
    if time[-1] - time[0] < _SHORTEST:
        return 0.0
    away = time - time.mean()
    return float(away @ psi / (away @ away))


def forward_speed(view: RoverView, wheel_radius: float) -> float:
    """Speed of the body along its x axis by the encoders, of wheels that do not slip [m/s]."""
    return wheel_radius * float(np.mean(view.wheel_speeds * np.cos(view.steer)))


def body_slip(wheel_slip: float, steer: float, speed: float, rate: float, behind: float) -> float:
    """Slip angle beta [rad] of a body whose rear axle lies ``behind`` its centre of mass [m] (Reina 2008, eq. 2).

    ``wheel_slip`` alpha_r is the direction of the rear wheel's travel against its own heading, ``steer`` delta_r that
    heading against the body, both + left: together they are the direction of travel in the body. (The paper writes
    alpha_r - delta_r: it counts one of the two to the other side, where its Fig. 4 has them.) ``rate`` is r [rad/s],
    ``speed`` V_x [m/s]; a rover that hardly moves has no R = V_x / r, and b / R is left out.
    """
    turning = behind * rate / speed if abs(speed) > _STANDING else 0.0
    return math.atan(math.tan(wheel_slip + steer) + turning)
