"""Sharing of the load within groups of axles on uneven road, for numbers or ``casadi.SX``.

Axles of one group share its load by ``load_share``. With rocker beams or large pipes between air springs they do so at
once, which is what a unit without ``load_sharing`` does. Else an axle that stands higher than its group carries more,
by the stiffness of its springs and tyres, until the group has equalised with a lag: of air through narrow pipes some
seconds, of separate springs practically never. The sum of the group's loads is not affected; its moment is, and so
is the load on the hitch. Only uneven road does this: on a plane the axles of a group stand in line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, Wheel
from vehicle.combination.loads import axle_groups
from vehicle.combination.unit import Unit
from vehicle.tyres import Num


class Sharing(NamedTuple):
    """Additional loads of the axles, and how fast they are equalised."""

    additional: list[list[Num]]  # of each axle of each unit [N]; empty for a unit that equalises at once
    rates: list[Num]  # of the state ``load_shift`` [N/s]


def sharing(vehicle: Vehicle, layout: Sequence[Wheel], s: State[Any], u: Input[Any]) -> Sharing:
    """Additional loads in a state, on the road of the inputs."""
    additional: list[list[Num]] = []
    rates: list[Num] = []
    for i, unit in enumerate(vehicle.units):
        if unit.load_sharing is None:
            additional.append([])
            continue
        places = [k for k, wheel in enumerate(layout) if wheel.unit == i]
        heights = [0.5 * (u.road[left] + u.road[left + 1]) for left in places[::2]]
        at_once = _by_height(unit, unit.load_sharing.stiffness, heights, towed=i > 0)
        first = len(rates)
        shifts = [s.load_shift[first + k] for k in range(len(at_once))]
        additional.append([load - shift for load, shift in zip(at_once, shifts, strict=True)])
        rates += [1.0 / unit.load_sharing.lag * load for load in additional[-1]]
    return Sharing(additional, rates)


def _by_height(unit: Unit, stiffness: Num, heights: Sequence[Num], *, towed: bool) -> list[Num]:
    """Load that each axle takes over as it stands above its group [N]; zero in the sum of the group."""
    loads: list[Num] = [0.0] * len(unit.axles)
    for group in axle_groups(unit, towed=towed):
        n = len(group.axles)
        mean = sum(share * heights[k] for share, k in zip(group.shares, group.axles, strict=True))
        for share, k in zip(group.shares, group.axles, strict=True):
            loads[k] = (n * stiffness * share) * (heights[k] - mean)
    return loads
