"""Moving traffic around a trailer, placed relative to the path that the trailer has driven.

A following vehicle keeps to the path of the trailer's rear. An overtaking one drives along the path of the hitch, on
the outside of a turn and clear of the trailer. A crossing one drives straight across the path behind the trailer. The
traffic depends on one generator and on the poses of the trailer, which moves forwards. Not modelled: vehicles that
brake for each other, turning wheels, shadows of vehicles on anything but the ground.

Origin of each: its middle on the ground, x forward. Sizes are those of real vehicles [m]. Not modelled: wheels that
turn or steer, the view through windows, reflections.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol, get_args

import numpy as np

from sensors.messages import StereoFrame
from sensors.textures import NoiseArray, TextureArray, fractal_noise, to_bytes
from sensors.world.scenery import Instances
from sensors.world.things import Colour, Mesh, Part, Thing, box, joined, pole, polygon
from sensors.world.world import World
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, cross

PAINT, LIVERY = "paint", "livery"
LORRY_AXLES, CAR_AXLES = (3.7, -3.0), (1.35, -1.3)  # front and rear, ahead of the middle [m]
_GLASS: Colour = (0.16, 0.19, 0.22)
_RUBBER: Colour = (0.10, 0.10, 0.11)
_COLOURS: tuple[Colour, ...] = (
    (0.86, 0.86, 0.84),
    (0.62, 0.12, 0.10),
    (0.13, 0.24, 0.48),
    (0.20, 0.22, 0.24),
    (0.78, 0.62, 0.12),
    (0.22, 0.42, 0.28),
)


def lorry(rng: np.random.Generator) -> Thing:
    """A rigid lorry, 10 m long, with a box body and a cab 3.9 m high."""
    cab = [(5.1, 0.45), (5.15, 1.5), (4.9, 3.0), (4.7, 3.6), (4.3, 3.85), (3.0, 3.88), (3.0, 0.45)]
    screen = np.array([[5.16, -1.05, 1.65], [5.16, 1.05, 1.65], [4.95, 1.05, 2.75], [4.95, -1.05, 2.75]])
    side = np.array([[4.85, 0.0, 1.7], [3.6, 0.0, 1.7], [3.6, 0.0, 2.6], [4.75, 0.0, 2.6]])
    body = box((-5.0, 2.85), (-1.275, 1.275), (0.95, 3.9), texture_size=3.0)
    frame = box((-4.9, 3.0), (-0.5, 0.5), (0.55, 0.95), texture_size=1.0)
    bumper = box((5.0, 5.22), (-1.2, 1.2), (0.35, 0.85), texture_size=0.8)
    grille = [box((5.1, 5.19), (-0.8, 0.8), (z, z + 0.07), texture_size=0.8) for z in (0.95, 1.12, 1.29)]
    lights = [box((5.2, 5.25), (y - 0.16, y + 0.16), (0.5, 0.72), texture_size=1.0) for y in (-0.95, 0.95)]
    mirrors = [box((4.9, 5.05), (y - 0.1, y + 0.1), (1.8, 2.6), texture_size=1.0) for y in (-1.42, 1.42)]
    wheels = [_wheel(x, y, 0.5, 0.33) for x in LORRY_AXLES for y in (-1.05, 1.05)]
    panes = [_outward(screen, np.zeros(3)), *(_side_pane(side, y) for y in (-1.262, 1.262))]
    return Thing(
        name="lorry",
        parts=(
            Part(mesh=_extruded(cab, 1.25), texture=PAINT, colour=_random_colour(rng)),
            Part(mesh=body, texture=LIVERY, colour=_random_colour(rng)),
            Part(mesh=joined(*panes), texture=PAINT, colour=_GLASS),
            Part(mesh=joined(frame, bumper, *grille, *mirrors, *wheels), texture=PAINT, colour=_RUBBER),
            Part(mesh=joined(*lights), texture=PAINT, colour=(1.2, 1.2, 1.1)),
        ),
        variety=0.0,
    )


def car(rng: np.random.Generator) -> Thing:
    """A saloon car, 4.4 m long."""
    lower = [(2.15, 0.28), (2.2, 0.62), (1.15, 0.92), (-2.05, 0.98), (-2.2, 0.75), (-2.15, 0.28)]
    upper = [(1.15, 0.9), (0.4, 1.4), (-0.9, 1.44), (-1.75, 0.96)]
    screen = np.array([[1.1, -0.62, 0.96], [1.1, 0.62, 0.96], [0.46, 0.58, 1.38], [0.46, -0.58, 1.38]])
    rear = np.array([[-1.72, -0.6, 1.0], [-1.72, 0.6, 1.0], [-0.98, 0.58, 1.41], [-0.98, -0.58, 1.41]])
    side = np.array([[0.9, 0.0, 0.98], [-1.45, 0.0, 1.0], [-0.9, 0.0, 1.36], [0.4, 0.0, 1.34]])
    lights = [box((2.1, 2.2), (y - 0.18, y + 0.18), (0.55, 0.7), texture_size=1.0) for y in (-0.62, 0.62)]
    plate = box((2.17, 2.22), (-0.26, 0.26), (0.36, 0.48), texture_size=1.0)
    wheels = [_wheel(x, y, 0.32, 0.2) for x in CAR_AXLES for y in (-0.78, 0.78)]
    inside = np.array([0.0, 0.0, 0.8])
    panes = [_lifted(screen, inside), _lifted(rear, inside), *(_side_pane(side, y) for y in (-0.735, 0.735))]
    colour = _random_colour(rng)
    return Thing(
        name="car",
        parts=(
            Part(mesh=joined(_extruded(lower, 0.88), _extruded(upper, 0.72)), texture=PAINT, colour=colour),
            Part(mesh=joined(*panes), texture=PAINT, colour=_GLASS),
            Part(mesh=joined(*wheels), texture=PAINT, colour=_RUBBER),
            Part(mesh=joined(*lights, plate), texture=PAINT, colour=(1.2, 1.2, 1.05)),
        ),
        variety=0.0,
    )


def vehicle_textures(rng: np.random.Generator) -> dict[str, TextureArray]:
    """Textures of the parts: paint with dirt and seams, and the lettering of a box body."""
    return {PAINT: _paint(rng), LIVERY: _livery(rng)}


def _random_colour(rng: np.random.Generator) -> Colour:
    return _COLOURS[int(rng.integers(len(_COLOURS)))]


def _paint(rng: np.random.Generator, size: int = 256) -> TextureArray:
    """Nearly uniform paint with streaks of dirt and two seams per repeat."""
    streaks = fractal_noise(rng, (size, size), 1.0, (0.0, 0.1))
    grain = fractal_noise(rng, (size, size), 0.3, (0.05, 0.4))
    level = np.asarray(0.88 + 0.05 * streaks + 0.02 * grain, dtype=np.float32)
    level[size // 2 : size // 2 + 3] *= 0.55
    level[:, size // 3 : size // 3 + 3] *= 0.55
    return _grey(level)


def _livery(rng: np.random.Generator, size: int = 512) -> TextureArray:
    """A broad band with letter-like blocks on painted sheets with rows of rivets; one repeat is 3 m."""
    level = np.full((size, size), 0.9, dtype=np.float32)
    level[size // 3 : 2 * size // 3] = 0.35
    u = 10
    while u < size - 50:
        width, height = int(rng.integers(14, 44)), int(rng.integers(60, 130))
        level[size // 2 - height // 2 : size // 2 + height // 2, u : u + width] = rng.uniform(0.75, 1.0)
        u += width + int(rng.integers(8, 22))
    level[:, :: size // 6] *= 0.7
    level += 0.04 * fractal_noise(rng, (size, size), 0.8, (0.0, 0.3))
    return _grey(level)


def _grey(level: NoiseArray) -> TextureArray:
    return to_bytes(np.repeat(level[..., None], 3, axis=-1))


def _outward(corners: FloatArray, centre: FloatArray, *, texture_size: float = 1.5, shade: float = 1.0) -> Mesh:
    """A flat polygon that faces away from the ``centre`` (3,)."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    ordered = corners if normal @ (corners.mean(axis=0) - centre) > 0.0 else corners[::-1]
    return polygon(ordered, texture_size=texture_size, shade=shade)


def _lifted(corners: FloatArray, centre: FloatArray) -> Mesh:
    """A polygon as of ``_outward``, 3 cm above the sheet it lies on."""
    pane = _outward(corners, centre)
    return pane.moved(by=tuple((0.03 * pane.normals[0]).tolist()))


def _side_pane(corners: FloatArray, y: float) -> Mesh:
    """A pane (n, 3), given in the xz plane, on the vehicle's side at y."""
    return _outward(corners + np.array([0.0, y, 0.0]), corners.mean(axis=0))


def _extruded(profile: list[tuple[float, float]], half_width: float) -> Mesh:
    """A convex outline (x, z) extruded across the vehicle; darker towards its underside."""
    outline = np.array([(x, 0.0, z) for x, z in profile])
    centre, across = outline.mean(axis=0), np.array([0.0, half_width, 0.0])
    faces = []
    for k, end in enumerate(outline):
        start = outline[k - 1]
        shade = 0.3 if max(start[2], end[2]) < 0.5 else 1.0
        faces.append(
            _outward(np.array([start - across, end - across, end + across, start + across]), centre, shade=shade)
        )
    sides = [_outward(outline + side * across, centre) for side in (-1.0, 1.0)]
    return joined(*faces, *sides)


def _wheel(x: float, y: float, radius: float, width: float) -> Mesh:
    """A wheel about an axle across the vehicle."""
    tread = pole((radius, -0.5 * width), (radius, 0.5 * width), sides=14)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # its axis from z to y
    middle = np.array([x, y, radius])
    vertices, normals = tread.vertices @ turned.T + middle, tread.normals @ turned.T
    tyre = replace(tread, vertices=vertices, normals=normals, shade=0.5 * tread.shade)
    angle = np.linspace(0.0, 2.0 * np.pi, 15)[:-1]
    rim = np.column_stack([radius * np.cos(angle), np.zeros(14), radius * np.sin(angle)]) + middle
    sides = [_outward(rim + np.array([0.0, side * 0.5 * width, 0.0]), middle) for side in (-1.0, 1.0)]
    hub, out = middle + 0.5 * (rim - middle), 0.5 * width + 0.01
    hubs = [_outward(hub + np.array([0.0, side * out, 0.0]), middle) for side in (-1, 1)]
    return joined(tyre, *sides, *hubs)


TrafficKind = Literal["following", "overtaking", "crossing", "mixed"]
KINDS: Final[tuple[TrafficKind, ...]] = get_args(TrafficKind)
MAX_VEHICLES: Final = 3  # at a time; the limit of the ground's shader
Height = Callable[[FloatArray], FloatArray]  # of the ground at (n, 2) [m]

_SPACING: Final = 0.05  # of the points of a driven path [m]
_KEPT: Final = 150.0  # length of the path that is stored; no vehicle is farther behind [m]
_HIDDEN: Final = -500.0  # height of a vehicle that is not present: under the ground [m]
_SURGE, _SURGE_PERIOD = 0.4, 7.0  # amplitude of a follower's gap [m], and period [s]
_WANDER, _WANDER_PERIOD = 0.2, 5.0  # the same for its lateral offset
_PASSING = (40.0, -25.0)  # distance behind the rear where overtaking starts and ends [m]
_FASTER, _LATERAL = 6.0, 3.6  # relative speed [m/s] and lateral offset [m] when overtaking
_CLEARANCE: Final = 1.5  # between the sides of the trailer and of an overtaking vehicle [m]
_HALF_WIDTH: Final = 1.3  # of vehicles [m]
_RETURN: Final = 12.0  # distance before and behind the trailer over which they pull out and in [m]
_OVERHANG: Final = 5.25 - LORRY_AXLES[0]  # from a lorry's front axle to its bumper [m]
_TURNING: Final = 0.1  # change of heading along a trailer length that makes a turn [rad]
_CROSSING_EVERY, _CROSSING_SPEED, _CROSSING_HALF = 9.0, 6.0, 24.0  # period [s], speed [m/s], reach to each side [m]
_BEHIND: Final = 3.0  # distance of the crossing point behind the rear's position when the vehicle starts [m]
_EVENTS: Final = 200  # random sides; after so many overtakings or crossings they repeat


class DrivenPath:
    """Path of a point of the trailer so far, extended by straight lines at both ends; it grows during a run."""

    def __init__(self) -> None:
        self._table: FloatArray = np.empty((0, 4))  # tick, station [m], x, y [m] of each point

    def extend(self, tick: int, point: FloatArray, heading: float) -> None:
        """Add a point if it is far enough from the last one; the path starts straight, along the first heading."""
        if not len(self._table):
            behind = point - np.array([math.cos(heading), math.sin(heading)])
            self._table = np.array([[tick - 1.0, -1.0, *behind]])
        step = float(np.linalg.norm(point - self._table[-1, 2:]))
        if step > _SPACING:
            kept = self._table[self._table[:, 1] > self.end - _KEPT]
            self._table = np.vstack([kept, [tick, self.end + step, *point]])

    @property
    def end(self) -> float:
        """Station of the newest point [m]."""
        return float(self._table[-1, 1])

    def station(self, tick: float) -> float:
        """Station at an earlier tick [m]."""
        return float(np.interp(tick, self._table[:, 0], self._table[:, 1]))

    def at(self, station: float) -> FloatArray:
        """Point (2,) at a station [m]."""
        along, points = self._table[:, 1], self._table[:, 2:]
        inside = float(np.clip(station, along[0], along[-1]))
        point = np.array([np.interp(inside, along, points[:, k]) for k in (0, 1)])
        if station == inside:
            return point
        ends = (points[0], points[1]) if station < inside else (self.at(inside - 1.0), point)
        tangent = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        return np.asarray(point + (station - inside) * tangent, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxlePoints:
    """Positions of a vehicle's axles."""

    front: FloatArray  # (2,) W [m]
    rear: FloatArray  # (2,) W [m]


class Traffic:
    """All vehicles of one run.

    Args:
        rng: of vehicles, sides and times.
        kind: manoeuvres of the vehicles.
        gap: from the cameras to the front of a following vehicle [m].
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
        self._delay = float(rng.uniform(0.0, 3.0))  # of the first overtaking or crossing [s]
        moves = {"following": self._following, "overtaking": self._overtaking, "crossing": self._crossing}
        chosen = tuple(moves) if kind == "mixed" else (kind,)
        self._moves = [moves[name] for name in chosen]
        self._things: list[Thing] = []
        self._axles: list[tuple[float, float]] = []
        for name in chosen:
            large = name == "following" or bool(rng.random() < 0.5)
            self._things.append(lorry(rng) if large else car(rng))
            self._axles.append(LORRY_AXLES if large else CAR_AXLES)
        self._hitch_path, self._rear_path = DrivenPath(), DrivenPath()
        self._tick, self._hitch, self._ahead = -1, np.zeros(2), np.array([1.0, 0.0])

    @property
    def hidden(self) -> tuple[Instances, ...]:
        """All vehicles, hidden under the ground."""
        return tuple(_instances(thing, _hidden_pose()) for thing in self._things)

    def at(self, truth: Truth) -> tuple[Instances, ...]:
        """Vehicles at the truth's tick; ticks must not decrease."""
        if truth.tick > self._tick:
            x, y, psi = truth.poses[-1]
            self._tick, self._hitch = truth.tick, np.array([x, y])
            self._ahead = np.array([math.cos(psi), math.sin(psi)])
            self._hitch_path.extend(truth.tick, self._hitch, psi)
            self._rear_path.extend(truth.tick, self._hitch - self._follow * self._ahead, psi)
        axle_points = [move(truth.tick * TICK, axles) for move, axles in zip(self._moves, self._axles, strict=True)]
        return tuple(
            _instances(thing, _hidden_pose() if points is None else self._pose(points, axles))
            for thing, points, axles in zip(self._things, axle_points, self._axles, strict=True)
        )

    def _following(self, time: float, axles: tuple[float, float]) -> AxlePoints | None:
        """Behind the rear, with a varying gap."""
        surge = _SURGE * math.sin(2.0 * math.pi * time / _SURGE_PERIOD + self._phases[0])
        offset = _WANDER * math.sin(2.0 * math.pi * time / _WANDER_PERIOD + self._phases[1])
        front = self._rear_path.end - self._gap - surge - _OVERHANG
        return _on_path(self._rear_path, front, axles, offset)

    def _overtaking(self, time: float, axles: tuple[float, float]) -> AxlePoints | None:
        """Repeatedly from behind the rear to ahead of the hitch, on the outside where the trailer turns."""
        event, since = divmod(time - self._delay, (_PASSING[0] - _PASSING[1]) / _FASTER)
        if event < 0:
            return None
        path = self._hitch_path
        start = path.station((time - since) / TICK)
        turn = _heading(path, start) - _heading(path, start - self._follow)
        turn = math.remainder(turn, 2.0 * math.pi)
        outside = -math.copysign(1.0, turn) if abs(turn) > _TURNING else self._sides[0, int(event) % _EVENTS]
        front = path.end - self._follow - _PASSING[0] + _FASTER * since
        return self._cleared(_on_path(path, front, axles, outside * _LATERAL), outside)

    def _crossing(self, time: float, axles: tuple[float, float]) -> AxlePoints | None:
        """Straight across the path behind the rear."""
        event, since = divmod(time - self._delay, _CROSSING_EVERY)
        distance = _CROSSING_SPEED * since - _CROSSING_HALF  # from the path, negative before it
        if event < 0 or distance > _CROSSING_HALF:
            return None
        path = self._rear_path
        station = path.station((time - since) / TICK) - _BEHIND
        side, heading = self._sides[1, int(event) % _EVENTS], _heading(path, station)
        across = side * np.array([-math.sin(heading), math.cos(heading)])
        front, rear = (path.at(station) + (distance + axle) * across for axle in axles)
        return AxlePoints(front=front, rear=rear)

    def _cleared(self, points: AxlePoints, side: float) -> AxlePoints:
        """The axle points, shifted to a side (+ left) as far as the clearance to the trailer requires."""
        needed = self._half_width + _HALF_WIDTH + _CLEARANCE
        left = side * np.array([-self._ahead[1], self._ahead[0]])
        shifted = []
        for point in (points.front, points.rear):
            along, lateral = float((point - self._hitch) @ self._ahead), float((point - self._hitch) @ left)
            beyond = max(along, -self._follow - along, 0.0)  # the trailer's ends
            share = max(0.0, 1.0 - beyond / _RETURN)
            missing = needed - lateral if abs(lateral) < needed else 0.0
            shifted.append(point + share * missing * left)
        return AxlePoints(front=shifted[0], rear=shifted[1])

    def _pose(self, points: AxlePoints, axles: tuple[float, float]) -> FloatArray:
        """Pose X_WV (4, 4) of a vehicle whose axles stand on the ground."""
        ahead = (points.front - points.rear) / np.linalg.norm(points.front - points.rear)
        left = np.array([-ahead[1], ahead[0]])
        wheels = np.array([points.front + left, points.front - left, points.rear + left, points.rear - left])
        z = self._height(wheels)
        x = np.append(ahead, 0.5 * (z[0] + z[1] - z[2] - z[3]) / (axles[0] - axles[1]))
        y = np.append(left, 0.25 * (z[0] - z[1] + z[2] - z[3]))
        x /= np.linalg.norm(x)
        up = cross(x, y)
        up /= np.linalg.norm(up)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([x, cross(up, x), up])
        rear_height = 0.5 * float(z[2] + z[3])
        pose[:3, 3] = np.append(points.rear, rear_height) - axles[1] * x
        return pose


def populated(world: World, traffic: Traffic) -> World:
    """The world with the vehicles as its moving things."""
    return replace(world, moving=traffic.hidden, textures=world.textures | traffic.textures)


class StereoSampler(Protocol):
    """A stereo camera."""

    def sample(self, truth: Truth) -> StereoFrame:
        """Stereo pair at the truth's tick."""


class MovableScene(Protocol):
    """A renderer that can move the world's moving things."""

    def place(self, moved: tuple[Instances, ...]) -> None:
        """Move the things to their current poses."""


class InTraffic:
    """A stereo camera; the traffic is moved before every capture."""

    def __init__(self, camera: StereoSampler, renderer: MovableScene, traffic: Traffic) -> None:
        self._camera, self._renderer, self._traffic = camera, renderer, traffic

    def sample(self, truth: Truth) -> StereoFrame:
        """Stereo pair captured at the truth's tick."""
        self._renderer.place(self._traffic.at(truth))
        return self._camera.sample(truth)


def _on_path(path: DrivenPath, front: float, axles: tuple[float, float], offset: float) -> AxlePoints:
    """Both axles ``offset`` [m] to the left of a path; the front one at station ``front`` [m]."""
    points = []
    for station in (front, front - axles[0] + axles[1]):
        heading = _heading(path, station)
        points.append(path.at(station) + offset * np.array([-math.sin(heading), math.cos(heading)]))
    return AxlePoints(front=points[0], rear=points[1])


def _heading(path: DrivenPath, station: float) -> float:
    """Heading of a path around a station [rad]."""
    chord = path.at(station + 0.5) - path.at(station - 0.5)
    return math.atan2(chord[1], chord[0])


def _instances(thing: Thing, pose: FloatArray) -> Instances:
    return Instances(thing=thing, poses=pose[None], brightness=np.ones(1))


def _hidden_pose() -> FloatArray:
    pose = np.eye(4)
    pose[2, 3] = _HIDDEN
    return pose
