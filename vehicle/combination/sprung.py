"""Sprung bodies: heave, pitch and roll of each unit, and sharing of the load within groups of axles.

Each motion x, relative to the smooth road, is a damped oscillation about the rest position that the rough road and the
specific force give:
x'' = w0^2 (road + forced - x) + 2 zeta w0 (road' - x'). With the auxiliary state w = x' - 2 zeta w0 (road - x) the
equation reads w' = w0^2 (road + forced - x), so that no rate of the road is needed. Heave is that of the centre of
gravity, and pitch is about it. A towed unit stands in front on the hitch of the unit ahead, which moves with that
unit's body.
If the suspensions are given, the roll of all bodies follows from them and from the hitches (``roll``).

The forces of springs and dampers load the wheels. The dampers' force due to the road's own rate is left out: the tyres,
whose vertical deflection is not modelled, would absorb it. Also not modelled: wheel hop, and coupling between the three
motions.

Axles of one group share its load by ``load_share``. With rocker beams or large pipes between air springs they do so at
once, which is what a unit without ``load_sharing`` does. Else an axle that stands higher than its group carries more,
by the stiffness of its springs and tyres, until the group has equalised with a lag: of air through narrow pipes some
seconds, of separate springs practically never. The sum of the group's loads is not affected; its moment is, and so
is the load on the hitch. Only uneven road does this: on a plane the axles of a group stand in line.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Chain, Input, State
from vehicle.combination.loads import axle_groups, axle_shares
from vehicle.combination.roll import UnitSprings, settled_rolls, springs_of
from vehicle.combination.unit import Unit
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
    felt: Attitude  # acceleration upward, specific forces forward and left that go with pitch and roll [m/s2]
    angles: tuple[Num, ...]  # of the body over the road at each axle [rad]; () without suspensions
    leans: tuple[Num, ...]  # the same with the dampers, as their moment is that of a larger angle


def settled(vehicle: Vehicle, specific_x: Sequence[Num], specific_y: Sequence[Num]) -> list[tuple[Attitude, Attitude]]:
    """Steady attitude and auxiliary states of every body under specific forces [m/s2] along its axes; smooth road."""
    bodies: list[tuple[Attitude, Attitude]] = []
    springs = springs_of(vehicle) if vehicle.has_springs else None
    rolls = _gradient_rolls(vehicle, specific_y) if springs is None else settled_rolls(vehicle, springs, specific_y)
    for i, unit in enumerate(vehicle.units):
        origin = _hitch_rise(vehicle, i, bodies[-1][0]) if i > 0 else 0.0
        heights = [0.0 for _ in unit.axles]
        road = _rest_attitude(unit, origin, heights, 0.0, towed=i > 0)
        forced = Attitude(0.0, -unit.pitch_gradient * specific_x[i], rolls[i])
        damping = _damping(unit, springs[i] if springs else None)
        auxiliary = Attitude(*(d * x for d, x in zip(damping, forced, strict=True)))
        bodies.append((Attitude(*(r + x for r, x in zip(road, forced, strict=True))), auxiliary))
    return bodies


def rides(chain: Chain, s: State[Any], u: Input[Any]) -> list[Ride]:
    """Motion of every body in a state."""
    motions = []
    roads = _road_rolls(chain, u)
    for i, (unit, road) in enumerate(zip(chain.units, _rest_attitudes(chain, s, u), strict=True)):
        of_roll = chain.springs[i] if chain.springs else None
        attitude = (s.heave[i], s.pitch[i], s.roll[i])
        auxiliary = (s.heave_spring[i], s.pitch_spring[i], s.roll_spring[i])
        damping = _damping(unit, of_roll)
        offset = Attitude(*(r - x for r, x in zip(road, attitude, strict=True)))
        rate = Attitude(*(w + c * d for w, c, d in zip(auxiliary, damping, offset, strict=True)))
        w_heave, w_pitch = _natural(unit)
        ratio = 2.0 * unit.suspension_damping
        heave = w_heave**2 * (offset.heave - ratio / w_heave * rate.heave)
        pitch = 1.0 / unit.pitch_gradient * (offset.pitch - ratio / w_pitch * rate.pitch)
        if of_roll is None:
            gradient, frequency = unit.roll_swing
            roll = -1.0 / gradient * (offset.roll - ratio / (math.tau * frequency) * rate.roll)
            motions.append(Ride(offset, rate, Attitude(heave, pitch, roll), (), ()))
        else:
            angles, damped = tuple(s.roll[i] - road for road in roads[i]), of_roll.time * rate.roll
            leans = tuple(angle + damped for angle in angles)
            motions.append(Ride(offset, rate, Attitude(heave, pitch, 0.0), angles, leans))
    return motions


def spring_rates(unit: Unit, ride: Ride, specific_x: Num, specific_y: Num) -> Attitude:
    """Rate of a body's auxiliary states [m/s2, rad/s2] under specific forces [m/s2] along its axes.

    That of roll is 0 if the suspensions are given: then it follows from ``roll.body_moments``.
    """
    (w_heave, w_pitch), offset = _natural(unit), ride.offset
    roll: Num = 0.0
    if unit.roll is None:
        gradient, frequency = unit.roll_swing
        roll = (math.tau * frequency) ** 2 * (offset.roll + gradient * specific_y)
    return Attitude(
        heave=w_heave**2 * offset.heave, pitch=w_pitch**2 * (offset.pitch - unit.pitch_gradient * specific_x), roll=roll
    )


def _gradient_rolls(vehicle: Vehicle, specific_y: Sequence[Num]) -> list[Num]:
    return [unit.roll_swing[0] * a_y for unit, a_y in zip(vehicle.units, specific_y, strict=True)]


def _natural(unit: Unit) -> tuple[Num, Num]:
    """Undamped angular frequencies of heave and pitch [rad/s]."""
    return math.tau * unit.heave_frequency, math.tau * unit.pitch_frequency


def _damping(unit: Unit, springs: UnitSprings | None) -> Attitude:
    """Rates of the dampers, 2 zeta w0 [1/s]."""
    ratio = 2.0 * unit.suspension_damping
    roll = ratio * (math.tau * unit.roll_swing[1]) if springs is None else springs.damping
    heave, pitch = _natural(unit)
    return Attitude(ratio * heave, ratio * pitch, roll)


def _road_rolls(chain: Chain, u: Input[Any]) -> dict[int, list[Num]]:
    """Angle of the rough road across each axle [rad], by unit."""
    rolls: dict[int, list[Num]] = {}
    for k, wheel in enumerate(chain.axles):
        rolls.setdefault(wheel.unit, []).append((1.0 / wheel.axle.track) * (u.road[2 * k] - u.road[2 * k + 1]))
    return rolls


def _rest_attitudes(chain: Chain, s: State[Any], u: Input[Any]) -> list[Attitude]:
    """Rest attitude of each body, from the rough road under it and the hitch in front of it."""
    attitudes: list[Attitude] = []
    for i, unit in enumerate(chain.units):
        axles = [(axle, u.road[2 * k], u.road[2 * k + 1]) for k, axle in enumerate(chain.axles) if axle.unit == i]
        heights = [0.5 * (left + right) for _, left, right in axles]
        if chain.springs is None:
            shares: list[Num] = [axle.roll_share for axle, _, _ in axles]
        else:
            springs = chain.springs[i]
            shares = [
                spring.stiffness / springs.stiffness / axle.track
                for spring, axle in zip(springs.axles, unit.axles, strict=True)
            ]
        roll = sum(share * (left - right) for share, (_, left, right) in zip(shares, axles, strict=True))
        origin = _hitch_rise(chain.vehicle, i, Attitude(s.heave[i - 1], s.pitch[i - 1], 0.0)) if i > 0 else 0.0
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


class LoadShifts(NamedTuple):
    """Additional loads of the axles, and how fast they are equalised."""

    additional: list[list[Num]]  # of each axle of each unit [N]; empty for a unit that equalises at once
    rates: list[Num]  # of the state ``load_shift`` [N/s]


def load_shifts(chain: Chain, s: State[Any], u: Input[Any]) -> LoadShifts:
    """Additional loads in a state, on the road of the inputs."""
    additional: list[list[Num]] = []
    rates: list[Num] = []
    for i, unit in enumerate(chain.units):
        if unit.load_sharing is None:
            additional.append([])
            continue
        lefts = [2 * k for k, axle in enumerate(chain.axles) if axle.unit == i]
        heights = [0.5 * (u.road[left] + u.road[left + 1]) for left in lefts]
        at_once = _by_height(unit, unit.load_sharing.stiffness, heights, towed=i > 0)
        first = len(rates)
        shifts = [s.load_shift[first + k] for k in range(len(at_once))]
        additional.append([load - shift for load, shift in zip(at_once, shifts, strict=True)])
        rates += [1.0 / unit.load_sharing.lag * load for load in additional[-1]]
    return LoadShifts(additional, rates)


def _by_height(unit: Unit, stiffness: Num, heights: Sequence[Num], *, towed: bool) -> list[Num]:
    """Load that each axle takes over as it stands above its group [N]; zero in the sum of the group."""
    loads: list[Num] = [0.0] * len(unit.axles)
    for group in axle_groups(unit, towed=towed):
        n = len(group.axles)
        mean = sum(share * heights[k] for share, k in zip(group.shares, group.axles, strict=True))
        for share, k in zip(group.shares, group.axles, strict=True):
            loads[k] = (n * stiffness * share) * (heights[k] - mean)
    return loads
