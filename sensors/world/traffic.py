"""Moving traffic behind and around a trailer: where each vehicle is, from the way that the trailer has come.

A vehicle that follows keeps to the way of the trailer's rear; one that overtakes goes along the way of its hitch, to
the outside of a turn and clear of the trailer; one that crosses goes straight across the way behind it. All of it
follows from one generator and from the poses of the trailer, which moves forwards. Not modelled: vehicles that brake
for one another, their wheels turning, shadows of theirs on anything but the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol, get_args

import numpy as np

from sensors.messages import StereoFrame
from sensors.world.road_vehicles import CAR_AXLES, LORRY_AXLES, car, lorry, vehicle_textures
from sensors.world.scenery import Stand
from sensors.world.textures import TextureArray
from sensors.world.things import Thing
from sensors.world.world import World
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, cross

TrafficKind = Literal["following", "overtaking", "crossing", "mixed"]
KINDS: Final[tuple[TrafficKind, ...]] = get_args(TrafficKind)
MOST: Final = 3  # vehicles at a time; the ground's shader knows of no more
Height = Callable[[FloatArray], FloatArray]  # of the ground at (n, 2) [m]

_APART: Final = 0.05  # of the points that a way is kept as [m]
_KEPT: Final = 150.0  # of a way; nobody is farther behind [m]
_NOWHERE: Final = -500.0  # height of a vehicle that is not there: under the ground [m]
_SURGE, _SURGE_PERIOD = 0.4, 7.0  # by which a follower comes nearer and falls back [m], and how often [s]
_WANDER, _WANDER_PERIOD = 0.2, 5.0  # the same to the sides
_PASSING, _FASTER, _BESIDE = (40.0, -25.0), 6.0, 3.6  # from and to behind the rear [m], by how much [m/s], aside [m]
_CLEAR: Final = 1.5  # of the trailer's side, to that of a vehicle that passes it [m]
_HALF_WIDTH: Final = 1.3  # of vehicles [m]
_RETURN: Final = 12.0  # way before and behind the trailer over which they move aside [m]
_OVERHANG: Final = 5.25 - LORRY_AXLES[0]  # from a lorry's front axle to its bumper [m]
_TURNING: Final = 0.1  # change of heading along a trailer length beyond which it is clear where the outside is [rad]
_CROSSING_EVERY, _CROSSING_SPEED, _CROSSING_HALF = 9.0, 6.0, 24.0  # [s], [m/s], way to both sides [m]
_BEHIND: Final = 3.0  # where a way is crossed, behind where the rear was when the vehicle set out [m]
_EVENTS: Final = 200  # overtakings and crossings that are drawn; then they repeat


class Way:
    """Where a point has come along; straight on beyond both ends.

    Not frozen, as it stands for what accumulates during a run.
    """

    def __init__(self) -> None:
        self._table: FloatArray = np.empty((0, 4))  # tick, station [m], x, y [m] of each point

    def extend(self, tick: int, point: FloatArray, heading: float) -> None:
        """One point more, unless it is hardly farther; before the first the way was straight, along the heading."""
        if not len(self._table):
            behind = point - np.array([math.cos(heading), math.sin(heading)])
            self._table = np.array([[tick - 1.0, -1.0, *behind]])
        step = float(np.linalg.norm(point - self._table[-1, 2:]))
        if step > _APART:
            kept = self._table[self._table[:, 1] > self.end - _KEPT]
            self._table = np.vstack([kept, [tick, self.end + step, *point]])

    @property
    def end(self) -> float:
        """Station of its newest point [m]."""
        return float(self._table[-1, 1])

    def station(self, tick: float) -> float:
        """Station at an earlier moment [m]."""
        return float(np.interp(tick, self._table[:, 0], self._table[:, 1]))

    def at(self, station: float) -> FloatArray:
        """The point (2,) at a station [m]."""
        along, points = self._table[:, 1], self._table[:, 2:]
        inside = float(np.clip(station, along[0], along[-1]))
        point = np.array([np.interp(inside, along, points[:, k]) for k in (0, 1)])
        if station == inside:
            return point
        ends = (points[0], points[1]) if station < inside else (self.at(inside - 1.0), point)
        tangent = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        return np.asarray(point + (station - inside) * tangent, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Where the axles of a vehicle are."""

    front: FloatArray  # (2,) W [m]
    rear: FloatArray  # (2,) W [m]


class Traffic:
    """All vehicles of one run.

    Args:
        rng: decides vehicles, sides and moments.
        kind: what they do.
        gap: from the cameras to the front of a vehicle that follows [m].
        follow_distance: of the trailer's rear from its hitch [m].
        half_width: of the trailer [m].
        height: of the ground.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        kind: TrafficKind,
        gap: float,
        follow_distance: float,
        half_width: float,
        height: Height,
    ) -> None:
        self.textures: dict[str, TextureArray] = vehicle_textures(rng)
        self._gap, self._follow, self._half_width, self._height = gap, follow_distance, half_width, height
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 2)
        self._sides = rng.choice([-1.0, 1.0], (2, _EVENTS))
        self._delay = float(rng.uniform(0.0, 3.0))  # of the first that overtakes or crosses [s]
        moves = {"following": self._following, "overtaking": self._overtaking, "crossing": self._crossing}
        chosen = tuple(moves) if kind == "mixed" else (kind,)
        self._moves = [moves[name] for name in chosen]
        self._things: list[Thing] = []
        self._axles: list[tuple[float, float]] = []
        for name in chosen:
            large = name == "following" or bool(rng.random() < 0.5)
            self._things.append(lorry(rng) if large else car(rng))
            self._axles.append(LORRY_AXLES if large else CAR_AXLES)
        self._hitch_way, self._rear_way = Way(), Way()
        self._tick, self._hitch, self._ahead = -1, np.zeros(2), np.array([1.0, 0.0])

    @property
    def parked(self) -> tuple[Stand, ...]:
        """The vehicles before anything moves, out of sight."""
        return tuple(_stand(thing, _nowhere()) for thing in self._things)

    def at(self, truth: Truth) -> tuple[Stand, ...]:
        """The vehicles at the moment of a truth; truths must come in their order."""
        if truth.tick > self._tick:
            x, y, psi = truth.poses[-1]
            self._tick, self._hitch = truth.tick, np.array([x, y])
            self._ahead = np.array([math.cos(psi), math.sin(psi)])
            self._hitch_way.extend(truth.tick, self._hitch, psi)
            self._rear_way.extend(truth.tick, self._hitch - self._follow * self._ahead, psi)
        places = [move(truth.tick * TICK, axles) for move, axles in zip(self._moves, self._axles, strict=True)]
        return tuple(
            _stand(thing, _nowhere() if place is None else self._pose(place, axles))
            for thing, place, axles in zip(self._things, places, self._axles, strict=True)
        )

    def _following(self, time: float, axles: tuple[float, float]) -> Place | None:
        """Behind the rear, now nearer and now farther."""
        surge = _SURGE * math.sin(2.0 * math.pi * time / _SURGE_PERIOD + self._phases[0])
        aside = _WANDER * math.sin(2.0 * math.pi * time / _WANDER_PERIOD + self._phases[1])
        front = self._rear_way.end - self._gap - surge - _OVERHANG
        return _beside(self._rear_way, front, axles, aside)

    def _overtaking(self, time: float, axles: tuple[float, float]) -> Place | None:
        """One after the other from behind the rear to ahead of the hitch, to the outside where the trailer turns."""
        event, since = divmod(time - self._delay, (_PASSING[0] - _PASSING[1]) / _FASTER)
        if event < 0:
            return None
        way = self._hitch_way
        began = way.station((time - since) / TICK)
        turn = _heading(way, began) - _heading(way, began - self._follow)
        turn = math.remainder(turn, 2.0 * math.pi)
        outside = -math.copysign(1.0, turn) if abs(turn) > _TURNING else self._sides[0, int(event) % _EVENTS]
        front = way.end - self._follow - _PASSING[0] + _FASTER * since
        return self._clear(_beside(way, front, axles, outside * _BESIDE), outside)

    def _crossing(self, time: float, axles: tuple[float, float]) -> Place | None:
        """Straight across the way behind the rear."""
        event, since = divmod(time - self._delay, _CROSSING_EVERY)
        passed = _CROSSING_SPEED * since - _CROSSING_HALF
        if event < 0 or passed > _CROSSING_HALF:
            return None
        way = self._rear_way
        met = way.station((time - since) / TICK) - _BEHIND
        side, heading = self._sides[1, int(event) % _EVENTS], _heading(way, met)
        across = side * np.array([-math.sin(heading), math.cos(heading)])
        return Place(front=way.at(met) + (passed + axles[0]) * across, rear=way.at(met) + (passed + axles[1]) * across)

    def _clear(self, place: Place, side: float) -> Place:
        """The place, pushed away from the trailer to a side (+ left) as far as needs be, if it is near it at all."""
        needed = self._half_width + _HALF_WIDTH + _CLEAR
        left = side * np.array([-self._ahead[1], self._ahead[0]])
        pushed = []
        for point in (place.front, place.rear):
            along, aside = float((point - self._hitch) @ self._ahead), float((point - self._hitch) @ left)
            beyond = max(along, -self._follow - along, 0.0)  # of the trailer's ends
            share = max(0.0, 1.0 - beyond / _RETURN)
            lacking = needed - aside if abs(aside) < needed else 0.0
            pushed.append(point + share * lacking * left)
        return Place(front=pushed[0], rear=pushed[1])

    def _pose(self, place: Place, axles: tuple[float, float]) -> FloatArray:
        """X_WV (4, 4) of a vehicle that stands on the ground with its axles."""
        ahead = (place.front - place.rear) / np.linalg.norm(place.front - place.rear)
        left = np.array([-ahead[1], ahead[0]])
        wheels = np.array([place.front + left, place.front - left, place.rear + left, place.rear - left])
        z = self._height(wheels)
        x = np.append(ahead, 0.5 * (z[0] + z[1] - z[2] - z[3]) / (axles[0] - axles[1]))
        y = np.append(left, 0.25 * (z[0] - z[1] + z[2] - z[3]))
        x /= np.linalg.norm(x)
        up = cross(x, y)
        up /= np.linalg.norm(up)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([x, cross(up, x), up])
        rear_height = 0.5 * float(z[2] + z[3])
        pose[:3, 3] = np.append(place.rear, rear_height) - axles[1] * x
        return pose


def populated(world: World, traffic: Traffic) -> World:
    """The world with the vehicles in it."""
    return replace(world, moving=traffic.parked, textures=world.textures | traffic.textures)


class Sampled(Protocol):
    """Stereo cameras."""

    def sample(self, truth: Truth) -> StereoFrame:
        """The pair of this moment."""


class Movable(Protocol):
    """A renderer that can put the world's moving things elsewhere."""

    def place(self, stands: tuple[Stand, ...]) -> None:
        """Move the things to where they stand now."""


class InTraffic:
    """Cameras, before whose every picture the traffic is put where it is."""

    def __init__(self, camera: Sampled, renderer: Movable, traffic: Traffic) -> None:
        self._camera, self._renderer, self._traffic = camera, renderer, traffic

    def sample(self, truth: Truth) -> StereoFrame:
        """The pair as captured at the truth's tick."""
        self._renderer.place(self._traffic.at(truth))
        return self._camera.sample(truth)


def _beside(way: Way, front: float, axles: tuple[float, float], aside: float) -> Place:
    """Both axles ``aside`` [m] of a way, to its left; the front one at station ``front``."""
    points = []
    for station in (front, front - axles[0] + axles[1]):
        heading = _heading(way, station)
        points.append(way.at(station) + aside * np.array([-math.sin(heading), math.cos(heading)]))
    return Place(front=points[0], rear=points[1])


def _heading(way: Way, station: float) -> float:
    """Direction of a way around a station [rad]."""
    chord = way.at(station + 0.5) - way.at(station - 0.5)
    return math.atan2(chord[1], chord[0])


def _stand(thing: Thing, pose: FloatArray) -> Stand:
    return Stand(thing=thing, poses=pose[None], brightness=np.ones(1))


def _nowhere() -> FloatArray:
    pose = np.eye(4)
    pose[2, 3] = _NOWHERE
    return pose
