"""Vertical tyre loads: equilibrium of the chain in pitch and in roll, for numbers or ``casadi.SX``.

Axles or bogies of the tractor are springs under a beam. Those of a towed unit are one compensated group or, if bogies
are named, springs under a beam that turns about the hitch. Within a group, loads are shared by ``load_share``; what
uneven road adds is in ``load_sharing``. Lateral load transfer is shared among a unit's axles in proportion to their
static loads. Accelerations are specific forces (without gravity's component along the ground), so that slopes load the
wheels correctly.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple, cast

import casadi as ca

from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.multibody import Vector, along, from_unit
from vehicle.combination.unit import Unit, grouped
from vehicle.tyres import Num

_LEAST_LOAD: Final = 10.0  # of a lifted wheel [N]: negligible, but avoids division by zero


class AxleShare(NamedTuple):
    """An axle's share of the weight on its unit's springs, and of the nose-down moment about the unit's origin."""

    of_weight: Num  # [-]
    of_moment: Num  # [1/m]


class ChainLoads(NamedTuple):
    """Vertical loads of a chain of units [N]."""

    axles: list[list[Num]]  # of each unit
    hitches: list[Num]  # on the unit ahead, of each towed unit


class LoadGroup(NamedTuple):
    """Axles that share one load."""

    axles: tuple[int, ...]
    shares: list[Num]  # of the group's load
    x: Num  # point of action of the load [m]
    stiffness: Num  # relative to the other groups


def static_axle_loads(vehicle: Vehicle) -> list[list[float]]:
    """Load [N] of each axle of each unit, standing on level ground."""
    n = len(vehicle.units)
    at_rest, ahead = Vector(0.0, 0.0), Vector(1.0, 0.0)
    loads = chain_loads(vehicle, [GRAVITY] * n, [0.0] * n, [at_rest] * n, [ahead] * n)
    return cast(list[list[float]], loads.axles)  # numbers unless the vehicle's numbers are symbols


def chain_loads(
    vehicle: Vehicle,
    gravity: Sequence[Num],
    a_x: Sequence[Num],
    hitch_forces: Sequence[Vector],
    e: Sequence[Vector],
    additional: Sequence[Sequence[Num]] = (),
) -> ChainLoads:
    """Load [N] of each axle of each unit and of each hitch.

    ``gravity`` is its component normal to the ground plus the upward acceleration of each unit and ``a_x`` each unit's
    specific force along its x axis [m/s2]; ``hitch_forces[i]`` acts on unit i at its front hitch, along unit i's axes
    [N] (unit 0: none); ``e`` are the directions of the units' x axes. ``additional`` are loads of each axle of each
    unit [N], or none, that add up to zero and whose moment the unit's group and hitch must balance.
    """
    loads: list[list[Num]] = [[] for _ in vehicle.units]
    hitches: list[Num] = []
    below: Num = 0.0  # load on the hitch of the unit at hand [N]
    for i in reversed(range(len(vehicle.units))):
        unit = vehicle.units[i]
        weight = unit.mass * gravity[i]
        # Pitching moment about the origin on the ground, nose down: gravity, inertia, and the hitches.
        moment = unit.cg_x * weight - (unit.cg_height * unit.mass) * a_x[i]
        if unit.hitch_x is not None and i + 1 < len(vehicle.units):
            pull = along(e[i], from_unit(e[i + 1], hitch_forces[i + 1]))
            moment = moment + unit.hitch_x * below - unit.rear_hitch[1] * pull.x
        if i > 0:
            moment = moment + vehicle.units[i - 1].rear_hitch[1] * hitch_forces[i].x
        weight = weight + below
        own = additional[i] if additional else ()
        moment = moment - sum(load * axle.x for load, axle in zip(own, unit.axles, strict=False))
        shares = axle_shares(unit, towed=i > 0)
        loads[i] = [share.of_weight * weight + share.of_moment * moment for share in shares]
        if own:
            loads[i] = [load + more for load, more in zip(loads[i], own, strict=True)]
        if i > 0:
            below = weight - sum(share.of_moment for share in shares) * moment
            hitches.insert(0, below)
    return ChainLoads(loads, hitches)


def axle_shares(unit: Unit, *, towed: bool) -> list[AxleShare]:
    """Load shares of the axles: springs under a beam, whose front rests on the hitch if towed."""
    groups = axle_groups(unit, towed=towed)
    n = sum(group.stiffness for group in groups)
    s_1 = sum(group.stiffness * group.x for group in groups)
    s_2 = sum(group.stiffness * group.x**2 for group in groups)
    by_axle = {}
    for group in groups:
        if towed:
            group_share = AxleShare(0.0, group.stiffness * group.x / s_2)
        else:
            scale = group.stiffness / (n * s_2 - s_1**2)
            group_share = AxleShare(scale * (s_2 - s_1 * group.x), scale * (n * group.x - s_1))
        for axle, share in zip(group.axles, group.shares, strict=True):
            by_axle[axle] = AxleShare(share * group_share.of_weight, share * group_share.of_moment)
    return [by_axle[axle] for axle in range(len(unit.axles))]


def axle_groups(unit: Unit, *, towed: bool) -> list[LoadGroup]:
    """Axles grouped by bogie; those of a towed unit without any bogie are one group."""
    whole = towed and all(axle.bogie is None for axle in unit.axles)
    groups = []
    for axles in grouped({k: "all" if whole else axle.bogie for k, axle in enumerate(unit.axles)}):
        total = sum(unit.axles[k].load_share for k in axles)
        shares: list[Num] = [unit.axles[k].load_share / total for k in axles]
        x = sum(share * unit.axles[k].x for share, k in zip(shares, axles, strict=True))
        groups.append(LoadGroup(axles, shares, x, total))
    return groups


def roll_moments(vehicle: Vehicle, a_y: Sequence[Num], roll: Sequence[Num], gravity: Sequence[Num]) -> list[Num]:
    """Roll moment [N m] on the axles of each unit, + to the right wheels.

    Inertia acts at the height of the centre of gravity, weight at its lateral offset as the body rolls. ``a_y`` is each
    unit's specific force to the left [m/s2], ``roll`` its body's angle, + left side up [rad], ``gravity`` as in
    ``chain_loads``.
    """
    moments: list[Num] = [0.0] * len(vehicle.units)
    from_behind: Num = 0.0
    for i in reversed(range(len(vehicle.units))):
        unit = vehicle.units[i]
        offset = (unit.mass * (unit.cg_height - unit.roll_axis_height)) * gravity[i] * roll[i]
        total = (unit.mass * unit.cg_height) * a_y[i] + offset + from_behind
        from_behind = unit.hitch_roll_share * total if i > 0 else 0.0
        moments[i] = total - from_behind
    return moments


def wheel_loads(axle_load: Num, transfer: Num) -> tuple[Num, Num]:
    """Loads [N] of the left and the right wheel; ``transfer`` is the load moved to the right [N].

    A lifted wheel carries almost nothing, and the other one the whole axle load.
    """
    whole = ca.fmax(axle_load, 2.0 * _LEAST_LOAD)
    left = ca.fmin(ca.fmax(0.5 * whole - transfer, _LEAST_LOAD), whole - _LEAST_LOAD)
    return left, whole - left
