"""Field of sand with a rover on it, whose wheels imprint their paths, and the true trace of a wheel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import zip_longest
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.sand.field import Field, Reach, Track, foreign_tracks, rolled
from sensors.sand.grid import Roll, Tread, window_around, window_of
from sensors.sand.relief import Relief, SandKind, kind_named
from sensors.sand.solids import Rock, scattered
from sensors.world.sky import daylight
from vehicle.frames import FloatArray, Pose2, wrap
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_SHORTEST, _LONGEST = 0.003, 0.02  # path that is imprinted at once [m]
_SHARPEST: Final = 0.5  # turn of the direction of travel beyond which a path starts anew [rad]
_SHALLOWEST: Final = 0.0008  # sinkage below which a wheel leaves no mark [m]
_MEMORY: Final = 0.03  # distance over which the berms follow the displaced sand [m]


class Stand(NamedTuple):
    """Place and motion of a wheel at one moment."""

    place: FloatArray  # (2,) of its lowest point in W [m]
    travel: float  # direction of travel in W [rad]
    slip_angle: float  # [rad]
    turned: float  # angle rolled so far [rad]
    sinkage: float  # [m]

    def distance(self, to: "Stand") -> float:
        """Distance to another stand [m]."""
        return math.dist(self.place, to.place)


@lru_cache(maxsize=2)  # each is the next one, and then the present one
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
        window = window_of(roll, roll.reach(self.tread))
        after, removed = rolled(field.sand(window), Track(roll, self.tread), window, field.relief, self.displaced)
        self.displaced += min(1.0, roll.length / _MEMORY) * (removed - self.displaced)
        field.write(window, after)


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


_PREPARED, _BESIDE = 0.3, 0.2  # sand is made this far ahead of the wheels, with this margin [m]
NEAREST, FARTHEST = 0.12, 0.60  # behind the wheel's centre: between the wheel and the far edge of the view [m]
_STEP: Final = 0.02  # [m]
_STANDS_APART: Final = 0.004  # distance between remembered stands [m]
_KEPT: Final = 400  # remembered stands: more than the length of a view


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceTruth:
    """Visible part of a wheel's own trace."""

    tick: int
    line: FloatArray  # (n, 2) middle of the rut in R behind the wheel, nearest first [m]
    there: NDArray[np.bool_]  # (n,) True where the ground took an imprint
    slip_angles: FloatArray  # (n,) of the wheel when it passed, + left [rad]
    wheel_slip: float  # of the wheel now, + left [rad]
    slip_angle: float  # of the body at R's origin now, + left [rad]

    @property
    def share(self) -> float:
        """Share of the visible length with an imprint."""
        return float(self.there.mean())

    @property
    def present(self) -> bool:
        """True if over half of the visible length has an imprint."""
        return self.share > 0.5


@dataclass(frozen=True, slots=True)
class WheelHistory:
    """History of a wheel: its last stands, oldest first."""

    stands: tuple[tuple[Stand, bool], ...] = ()  # with True where the wheel left an imprint

    def extended(self, stand: Stand, imprinted: bool) -> "WheelHistory":
        """History with one more stand; the oldest are dropped."""
        if self.stands and math.dist(self.stands[-1][0].place, stand.place) < _STANDS_APART:
            return self
        return WheelHistory((*self.stands[-_KEPT:], (stand, imprinted)))

    def seen_from(self, truth: RoverTruth, wheel: tuple[float, float], slip: float) -> TraceTruth:
        """Trace behind a wheel at a place in R [m] whose slip angle is ``slip`` [rad]."""
        stations = np.arange(NEAREST, FARTHEST + 1e-9, _STEP)
        places = np.array([stand.place for stand, _ in self.stands]).reshape(-1, 2)
        x, y = Pose2(*truth.pose.tolist()).inverse().apply(places).T
        behind = wheel[0] - x
        order = np.argsort(behind, kind="stable")
        there = np.array([imprinted for _, imprinted in self.stands], dtype=float)
        angles = np.array([stand.slip_angle for stand, _ in self.stands])
        offset, share, slips = (np.interp(stations, behind[order], value[order]) for value in (y, there, angles))
        reached = stations <= behind.max(initial=-1.0)
        return TraceTruth(
            tick=truth.tick,
            line=np.stack([wheel[0] - stations, offset], axis=-1),
            there=(share > 0.5) & reached,
            slip_angles=slips,
            wheel_slip=slip,
            slip_angle=truth.slip_angle,
        )


LUGS: Final = 20  # on a wheel of El Dorado II; assumed, no photograph is good enough to count them
LUG_HEIGHT: Final = 0.005  # [m], assumed


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun:
    """Position of the sun."""

    azimuth: float  # in W, + left of x [rad]
    elevation: float  # above the horizon [rad]


class SandWorld:
    """Sand under one sun that keeps the imprints of wheels.

    Args:
        kind: one of ``sensors.sand.relief.KINDS``.
        rng: decides everything not given here; equal generators give bitwise equal worlds.
        rover: leaves traces with its wheels.
        terrain: large shape of the ground.
        route: approximate path (n, 2) of the rover in W [m]: rocks stay clear of it, tracks of others cross it, ripples
            lie across its start.
        sun: None lets ``rng`` draw one from the range of the kind.

    Raises:
        ValueError: for an unknown kind, or a sun too low.
    """

    def __init__(
        self,
        kind: str,
        *,
        rng: np.random.Generator,
        rover: Rover,
        terrain: Terrain,
        route: FloatArray,
        sun: Sun | None = None,
        overcast: bool = False,
    ) -> None:
        look = kind_named(kind)
        sun_rng, relief_rng, rock_rng, track_rng = rng.spawn(4)
        step = route[min(len(route) - 1, 3)] - route[0]
        ahead = math.atan2(step[1], step[0])
        position = _sun(sun_rng, look, ahead) if sun is None else sun
        self.kind, self.rover, self.terrain, self.sun = look, rover, terrain, position
        self.light = daylight(position.azimuth, elevation=position.elevation, overcast=overcast)
        self.rocks: tuple[Rock, ...] = scattered(rock_rng, look.rocks, route, terrain) if look.rocks else ()
        crest = ahead + relief_rng.uniform(-0.3, 0.3)
        tracks = foreign_tracks(track_rng, route, 0.5 * rover.tread) if look.foreign_tracks else ()
        relief = Relief.draw(relief_rng, look, terrain, crest)
        self.field = Field(relief=relief, sun=self.light, tracks=tracks, rocks=self.rocks, reach=Reach.of(self.light))
        tread = Tread(radius=rover.radius, width=rover.width, lugs=LUGS, lug_height=LUG_HEIGHT)
        self._wheels = [Wheel(tread) for _ in rover.wheels]
        self._watched = rover.rear_left
        self._history = WheelHistory()

    def drive(self, truths: Sequence[RoverTruth], after: RoverTruth | None = None) -> None:
        """Imprint the wheels' paths through these moments, which continue the earlier ones, and go on to ``after``."""
        moments = [stands(truth) for truth in truths]
        for now, then in zip_longest(moments, [*moments[1:], *([stands(after)] if after else [])]):
            for k, wheel in enumerate(self._wheels):
                wheel.roll_on(self.field, now[k], then[k] if then else None)
            self._history = self._history.extended(now[self._watched], now[self._watched].sinkage > 0.0)

    def prepare(self, truth: RoverTruth) -> None:
        """Make some sand that the rover is about to reach; without it, it is made then."""
        v_x, v_y = truth.X_WB[:2, :2] @ truth.velocity[:2]
        ahead = truth.wheel_positions[:, :2] + _PREPARED * np.array([v_x, v_y]) / max(math.hypot(v_x, v_y), 1e-3)
        self.field.make_one(window_around(ahead, _BESIDE))

    def trace_truth(self, truth: RoverTruth) -> TraceTruth:
        """Trace of the left rear wheel relative to the rover's present pose."""
        x, y = self.rover.wheel_places[self._watched].tolist()
        return self._history.seen_from(truth, (x, y), float(truth.slip_angles[self._watched]))


def _sun(rng: np.random.Generator, kind: SandKind, ahead: float) -> Sun:
    """Draw a sun from the range of a kind, for a rover that starts towards ``ahead`` [rad]."""
    return Sun(azimuth=ahead + rng.uniform(*kind.azimuth), elevation=rng.uniform(*kind.elevation))
