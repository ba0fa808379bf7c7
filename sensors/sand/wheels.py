"""Wheels of a rover that imprint their paths into a field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from sensors.sand.field import Field
from sensors.sand.grid import slumped
from sensors.sand.imprint import Roll, Sand, Tread, imprinted, strip_of, window_of
from vehicle.frames import FloatArray, wrap
from vehicle.rover.truth import RoverTruth

_SHORTEST, _LONGEST = 0.003, 0.02  # path that is imprinted at once [m]
_SHARPEST: Final = 0.5  # turn of the direction of travel beyond which a path starts anew [rad]
_SHALLOWEST: Final = 0.0008  # sinkage below which a wheel leaves no mark [m]
_MEMORY: Final = 0.03  # distance over which the berms follow the displaced sand [m]
_SWEEPS: Final = 4  # of slumping after each imprint


class Stand(NamedTuple):
    """Place and motion of a wheel at one moment."""

    place: FloatArray  # (2,) of its lowest point in W [m]
    travel: float  # direction of travel in W [rad]
    slip_angle: float  # [rad]
    turned: float  # angle rolled so far [rad]
    sinkage: float  # [m]

    def distance(self, to: Stand) -> float:
        """Distance to another stand [m]."""
        return math.dist(self.place, to.place)


def stands(truth: RoverTruth) -> tuple[Stand, ...]:
    """Stands of all wheels of a rover."""
    return tuple(
        Stand(
            place=truth.wheel_positions[k, :2],
            travel=float(truth.wheel_headings[k] + truth.slip_angles[k]),
            slip_angle=float(truth.slip_angles[k]),
            turned=float(truth.wheel_turns[k]),
            sinkage=float(truth.sinkages[k]),
        )
        for k in range(len(truth.wheel_headings))
    )


@dataclass(slots=True)
class Wheel:
    """Wheel that leaves an imprint, with the end of its last one."""

    tread: Tread
    last: Stand | None = None
    displaced: float = 0.0  # sand per length of path, smoothed [m2]

    def roll_on(self, field: Field, to: Stand, after: Stand | None = None) -> None:
        """Imprint the path to ``to``, if it is long enough to show.

        ``after`` is the next stand, if it is known: short paths are imprinted together.
        """
        if self.last is None:
            self.last, self.displaced = to, to.sinkage * self.tread.width
            return
        distance = self.last.distance(to)
        if distance < _SHORTEST or (after is not None and self.last.distance(after) <= _LONGEST):
            return
        pieces = math.ceil(distance / _LONGEST)
        for k in range(pieces):
            self._imprint(field, _between(self.last, to, k / pieces), _between(self.last, to, (k + 1) / pieces))
        self.last = to

    def _imprint(self, field: Field, a: Stand, b: Stand) -> None:
        roll = _roll(a, b)
        if roll.sinkage < _SHALLOWEST:
            return
        reach = roll.reach(self.tread)
        window = window_of(roll, reach)
        strip = strip_of(roll, window, reach)
        inside, sand, relief = strip.inside, field.sand(window), field.relief
        large, crumbs = relief.large(window)[inside], relief.crumbs(window).texels(inside)
        after, removed = imprinted(roll, self.tread, strip, sand.texels(inside), large, crumbs, self.displaced)
        self.displaced += min(1.0, roll.length / _MEMORY) * (removed - self.displaced)
        new = sand.with_texels(inside, after)
        field.write(window, Sand(slumped(new.height, inside, _SWEEPS), new.packed))


def _between(a: Stand, b: Stand, share: float) -> Stand:
    """Interpolated stand."""
    mixed = [
        p + share * (q - p) for p, q in ((a.slip_angle, b.slip_angle), (a.turned, b.turned), (a.sinkage, b.sinkage))
    ]
    return Stand(a.place + share * (b.place - a.place), a.travel + share * wrap(b.travel - a.travel), *mixed)


def _roll(a: Stand, b: Stand) -> Roll:
    """Path from a to b; its ends are square to the travel there, unless that differs much from the path."""
    step = b.place - a.place
    straight = math.atan2(step[1], step[0])
    ends = [end if abs(wrap(end - straight)) < _SHARPEST else straight for end in (a.travel, b.travel)]
    towards = [np.array([math.cos(end), math.sin(end)]) for end in ends]
    return Roll(
        a=a.place,
        b=b.place,
        towards_a=towards[0],
        towards_b=towards[1],
        slip_angle=0.5 * (a.slip_angle + b.slip_angle),
        turned_a=a.turned,
        turned_b=b.turned,
        sinkage=0.5 * (a.sinkage + b.sinkage),
    )
