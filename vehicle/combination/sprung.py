"""Sprung bodies: heave, pitch and roll of each unit on its springs, for numbers or ``casadi.SX``.

Each motion x, relative to the smooth road, is a damped oscillation about the rest position that the rough road and the
specific force give:
x'' = w0^2 (road + forced - x) + 2 zeta w0 (road' - x'). With a companion w, x' = w + 2 zeta w0 (road - x) and
w' = w0^2 (road + forced - x), so that no rate of the road is needed. Heave is that of the centre of gravity, and pitch
is about it. A towed unit stands in front on the hitch of the unit ahead, which moves with that unit's body.

The forces of springs and dampers load the wheels. The dampers' force due to the road's own rate is left out: the tyres,
whose vertical deflection is not modelled, would absorb it. Also not modelled: wheel hop, and coupling between the three
motions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from vehicle.combination.description import Unit, Vehicle
from vehicle.combination.layout import Input, State, Wheel
from vehicle.combination.loads import axle_shares
from vehicle.tyres import Num


class Attitude(NamedTuple):
    """Heave (up), pitch (+ nose down) and roll (+ left side up) of a body [m, rad], or rates of them."""

    heave: Num
    pitch: Num
    roll: Num


class Ride(NamedTuple):
    """Motion of a body, and the accelerations that its springs and dampers transmit."""

    offset: Attitude  # rest attitude on this road, less the attitude [m, rad]
    rate: Attitude  # of the attitude [m/s, rad/s]
    felt: Attitude  # acceleration upward, and the specific forces forward and left that go with pitch and roll [m/s2]


def settled(vehicle: Vehicle, specific_x: Sequence[Num], specific_y: Sequence[Num]) -> list[tuple[Attitude, Attitude]]:
    """Steady attitude and companions of every body under specific forces [m/s2] along its axes, on smooth road."""
    bodies: list[tuple[Attitude, Attitude]] = []
    for i, unit in enumerate(vehicle.units):
        origin = _hitch_rise(vehicle, i, bodies[-1][0]) if i > 0 else 0.0
        heights = [0.0 for _ in unit.axles]
        road = _rest_attitude(unit, origin, heights, 0.0, towed=i > 0)
        forced = Attitude(0.0, -unit.pitch_gradient * specific_x[i], unit.roll_gradient * specific_y[i])
        companions = (2.0 * unit.suspension_damping * w0 * x for w0, x in zip(_natural(unit), forced, strict=True))
        bodies.append((Attitude(*(r + x for r, x in zip(road, forced, strict=True))), Attitude(*companions)))
    return bodies


def rides(vehicle: Vehicle, layout: Sequence[Wheel], s: State[Any], u: Input[Any]) -> list[Ride]:
    """Motion of every body in a state."""
    motions = []
    for i, (unit, road) in enumerate(zip(vehicle.units, _rest_attitudes(vehicle, layout, s, u), strict=True)):
        natural = _natural(unit)
        attitude = (s.heave[i], s.pitch[i], s.roll[i])
        companions = (s.heave_spring[i], s.pitch_spring[i], s.roll_spring[i])
        damping = 2.0 * unit.suspension_damping
        offset = Attitude(*(r - x for r, x in zip(road, attitude, strict=True)))
        rate = Attitude(*(w + damping * w0 * d for w, w0, d in zip(companions, natural, offset, strict=True)))
        pull = Attitude(*(d - damping / w0 * v for d, w0, v in zip(offset, natural, rate, strict=True)))
        felt = Attitude(
            heave=natural.heave**2 * pull.heave,
            pitch=1.0 / unit.pitch_gradient * pull.pitch,
            roll=-1.0 / unit.roll_gradient * pull.roll,
        )
        motions.append(Ride(offset, rate, felt))
    return motions


def spring_rates(unit: Unit, ride: Ride, specific_x: Num, specific_y: Num) -> Attitude:
    """Rate of a body's companions [m/s2, rad/s2] under specific forces [m/s2] along its axes."""
    w, offset = _natural(unit), ride.offset
    return Attitude(
        heave=w.heave**2 * offset.heave,
        pitch=w.pitch**2 * (offset.pitch - unit.pitch_gradient * specific_x),
        roll=w.roll**2 * (offset.roll + unit.roll_gradient * specific_y),
    )


def _natural(unit: Unit) -> Attitude:
    """Undamped angular frequencies [rad/s]."""
    return Attitude(*(math.tau * f for f in (unit.heave_frequency, unit.pitch_frequency, unit.roll_frequency)))


def _rest_attitudes(vehicle: Vehicle, layout: Sequence[Wheel], s: State[Any], u: Input[Any]) -> list[Attitude]:
    """Rest attitude of each body, from the rough road under it and the hitch in front of it."""
    attitudes: list[Attitude] = []
    for i, unit in enumerate(vehicle.units):
        wheels = [(wheel, u.road[k]) for k, wheel in enumerate(layout) if wheel.unit == i]
        axles = list(zip(wheels[::2], wheels[1::2], strict=True))
        heights = [0.5 * (left + right) for (_, left), (_, right) in axles]
        roll = sum(wheel.roll_share * (left - right) for (wheel, left), (_, right) in axles)
        origin = _hitch_rise(vehicle, i, Attitude(s.heave[i - 1], s.pitch[i - 1], 0.0)) if i > 0 else 0.0
        attitudes.append(_rest_attitude(unit, origin, heights, roll, towed=i > 0))
    return attitudes


def _hitch_rise(vehicle: Vehicle, i: int, body: Attitude) -> Num:
    """Rise of the front hitch of unit i [m] with the body of the unit ahead."""
    ahead = vehicle.units[i - 1]
    return body.heave - (ahead.rear_hitch[0] - ahead.cg_x) * body.pitch


def _rest_attitude(unit: Unit, hitch: Num, heights: Sequence[Num], roll: Num, *, towed: bool) -> Attitude:
    """Attitude of a body whose springs are at rest on axles of these heights [m] and, if towed, on its hitch.

    The springs of a beam at rest do no work, so heights are weighted as loads are shared.
    """
    shares = axle_shares(unit, towed=towed)
    front = hitch if towed else sum(share.of_weight * z for share, z in zip(shares, heights, strict=True))
    # Road heights are inputs and the hitch is a state, so that their effects are computed apart.
    dip = sum(-share.of_moment * z for share, z in zip(shares, heights, strict=True))
    pitch = dip + hitch * sum(share.of_moment for share in shares) if towed else dip
    return Attitude(heave=front - unit.cg_x * pitch, pitch=pitch, roll=roll)
