"""Mirror symmetry of the state: coordinates that swapping left and right keeps, and those that it flips.

A straight-running vehicle is its own mirror image, so to first order the two halves of its state do not act on each
other: lateral motion is linear in the flipped coordinates, and straight running is a balance in the kept ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from vehicle.combination.brake_channels import Channel, brake_channels
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, state_sizes
from vehicle.frames import FloatArray

SIGNS: Final = State(  # of each part in the mirror; the wheels of an axle also change places
    x=1,
    y=-1,
    psi=-1,
    v_x=1,
    v_y=-1,
    yaw_rate=-1,
    heave=1,
    pitch=1,
    roll=-1,
    heave_spring=1,
    pitch_spring=1,
    roll_spring=-1,
    load_shift=1,
    side_force=-1,
    hitch_x=1,
    hitch_y=-1,
    omega=1,
    deflection_x=1,
    deflection_y=-1,
    brake_windup=1,
    twin_x=1,
    twin_y=-1,
    steer=-1,
    acceleration=1,
    brake_pressure=1,
    brake_valve=1,
)
_PER_WHEEL: Final = frozenset({"omega", "deflection_x", "deflection_y", "brake_windup", "twin_x", "twin_y"})
_PER_CHANNEL: Final = frozenset({"brake_pressure", "brake_valve"})
_PER_HITCH: Final = frozenset({"hitch_x", "hitch_y"})
_SINGLE: Final = frozenset({"x", "y", "v_x", "v_y", "acceleration"})


class Coordinate(NamedTuple):
    """Scalar coordinate of the state, ``reading`` @ state; a change by 1 changes the state by ``direction``."""

    name: str
    kind: str  # its part of the state, or "articulation"
    direction: FloatArray  # (n_x,)
    reading: FloatArray  # (n_x,)


def kept(vehicle: Vehicle) -> tuple[Coordinate, ...]:
    """Coordinates that a mirror keeps; for an axle's wheels their mean or half their difference."""
    return tuple(_coordinates(vehicle, +1))


def flipped(vehicle: Vehicle) -> tuple[Coordinate, ...]:
    """Coordinates that a mirror flips; yaw angles as that of the tractor and the articulations."""
    return tuple(_coordinates(vehicle, -1))


def _coordinates(vehicle: Vehicle, sign: int) -> Iterator[Coordinate]:
    sizes = state_sizes(vehicle)
    rows = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
    for part, part_rows, own in zip(State._fields, rows, SIGNS, strict=True):
        if part in _PER_WHEEL:
            yield from _per_axle(part, part_rows, sign * own)
        elif part in _PER_CHANNEL:
            channels = brake_channels(vehicle)
            yield from _per_channel(part, part_rows, channels, sign * own)
        elif sign == own:
            yield from _angles(part_rows) if part == "psi" else _plain(part, part_rows)


def _per_axle(part: str, rows: FloatArray, side: int) -> Iterator[Coordinate]:
    """Mean of each axle's two wheels (side +1), or half the left one's excess over the right one (-1)."""
    for k, (left, right) in enumerate(zip(rows[::2], rows[1::2], strict=True)):
        yield Coordinate(f"{part}_{k}", part, left + side * right, 0.5 * (left + side * right))


def _per_channel(part: str, rows: FloatArray, channels: Sequence[Channel], side: int) -> Iterator[Coordinate]:
    """The same of brake channels with this state; a channel of both sides is its own mirror image."""
    present = [k for k, channel in enumerate(channels) if part == "brake_pressure" or channel.valve is not None]
    row = dict(zip(present, rows, strict=True))
    for k in present:
        mirrored = channels[k].mirrored
        if mirrored == k and side == +1:
            yield Coordinate(f"{part}_{k}", part, row[k], row[k])
        elif mirrored > k:
            sum_ = row[k] + side * row[mirrored]
            yield Coordinate(f"{part}_{k}", part, sum_, 0.5 * sum_)


def _angles(rows: FloatArray) -> Iterator[Coordinate]:
    """Yaw of the whole straight combination, then the articulation of each towed unit, psi ahead less psi."""
    yield Coordinate("psi", "psi", rows.sum(axis=0), rows[0])
    for k in range(1, len(rows)):
        yield Coordinate(f"articulation_{k}", "articulation", -rows[k:].sum(axis=0), rows[k - 1] - rows[k])


def _plain(part: str, rows: FloatArray) -> Iterator[Coordinate]:
    first = 1 if part in _PER_HITCH else 0  # a hitch has the number of the unit behind it
    for k, row in enumerate(rows, start=first):
        yield Coordinate(part if part in _SINGLE else f"{part}_{k}", part, row, row)
