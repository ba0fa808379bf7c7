"""Drivers by hand as pilots of environments: what a policy is compared with.

They know the vehicle's file, not the episode's load, length and friction.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from controllers.path import Path, Segment
from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from controllers.trailer_steering.policy import Network
from offtrack.environments.core import Features
from offtrack.environments.drivers import Drivers, Tracks
from offtrack.environments.driving import Goal, Road, TractorTrailerDriving
from offtrack.environments.rover_options import FEATURES
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.assembly.rover_run import rover_geometry
from scenarios.courses import Course
from vehicle.frames import FloatArray, Pose2

Actions = NDArray[np.float32]


class Pilot(Protocol):
    """Decides the actions of all episodes of an environment."""

    def begin(self, observation: Features, /) -> None:
        """Begin episodes in all lanes, with their first observation (n, n_features)."""

    def act(self, observation: Features, going: NDArray[np.bool_], /) -> Actions:
        """Actions (n, n_action) for an observation, once a control step; any for episodes that are over."""


class NetworkPilot:
    """A network that steers all episodes."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def begin(self, observation: Features) -> None:
        """Do nothing: the network has no memory."""

    def act(self, observation: Features, going: NDArray[np.bool_]) -> Actions:
        """Actions of the network."""
        return self._network(observation.astype(np.float64)).astype(np.float32)


class OnRoad:
    """The preview driver of scenarios, at set speed."""

    def __init__(self, core: TractorTrailerDriving) -> None:
        """For the episodes of a core."""
        self._core, self._chain = core, RollingChain.of(core.vehicle)

    def begin(self, observation: Features) -> None:
        """Begin on the roads."""
        road = self._core.aim
        if isinstance(road, Road):
            self._follow(road.tracks, road.course, road.max_speed)

    def act(self, observation: Features, going: NDArray[np.bool_]) -> Actions:
        """Actions (n, 2)."""
        now = self._core.now
        steer, acceleration = self._drivers.step(now.poses[:, 0], now.velocities[:, 0])
        return np.nan_to_num(np.column_stack([steer / self._chain.max_steer, acceleration])).astype(np.float32)

    def _follow(self, tracks: Tracks, course: NDArray[np.intp], speed: FloatArray) -> None:
        n, guided = self._core.n, tuple(tracks.references[0].tolist())
        self._drivers = Drivers(tractor_guided_at(self._core.vehicle, guided), tracks, n, "auto")
        self._drivers.begin(np.arange(n), course, speed)


class ThroughGate(OnRoad):
    """Plans the path of the last axle through the gate, and drives the tractor on the path that follows from it.

    The plan is a curve of seventh order. Kinematic trailers are flat: the path of the last
    axle determines that of the tractor.
    """

    _SPEED: Final = 4.0  # [m/s]
    _EARLY: Final = 8.0  # the curve ends before the gate: trailers that are longer or slide settle on the straight [m]

    def begin(self, observation: Features) -> None:
        """Plan for all episodes."""
        courses = [self._course(goal @ Pose2(-self._EARLY, 0.0, 0.0)) for goal in _goals(self._core, self._chain)]
        self._follow(Tracks(courses), np.arange(len(courses)), np.full(len(courses), self._SPEED))

    def _course(self, goal: Pose2) -> Course:
        reference = _reference(self._chain, _straight(self._chain, Pose2(0.0, 0.0, 0.0)), goal)
        x_ref = self._core.vehicle.units[0].front_x
        path = _path(_tractor(self._chain, reference, x_ref)[reference.stations >= 0.0])
        return Course(
            path=path,
            reference=(x_ref, 0.0),
            start=Pose2(0.0, 0.0, 0.0),
            surface_centre=None,
            centreline=path.points(1.0),
            road_half_width=1.0,
        )


class _Plan(NamedTuple):
    """Way into a bay."""

    stop: Pose2  # of the tractor, straight ahead
    reference: ReverseReference  # of the last axle in reverse from there
    station: float | None  # of the last axle; None before the stop [m]


class IntoBay:
    """Pulls forward as far as the curve into the bay needs, and reverses along it with the shipped reversing law."""

    _FARTHEST: Final = 24.0  # straight ahead at first [m]
    _MISSED, _AGAIN = 0.1, 12.0  # past the bay's end, from where it is tried again: at least so far ahead [m]
    _MOST_FOLDED: Final = math.radians(30.0)
    _SHARPEST: Final = 0.6  # of the tractor's curvature at full lock
    _SPEED, _GENTLE, _CREEP = 1.5, 0.3, 0.05  # [m/s], [m/s2], [m/s]
    _GAIN: Final = 2.0  # acceleration per error of the speed [1/s]

    def __init__(self, core: TractorTrailerDriving) -> None:
        """For the episodes of a core."""
        self._core, self._chain = core, RollingChain.of(core.vehicle)
        self._law = ReversingLaw(self._chain)

    def begin(self, observation: Features) -> None:
        """Plan for all episodes."""
        self._goals = _goals(self._core, self._chain)
        self._plans = [self._planned(goal, Pose2(0.0, 0.0, 0.0), 0.0) for goal in self._goals]

    def act(self, observation: Features, going: NDArray[np.bool_]) -> Actions:
        """Actions (n, 2)."""
        actions = np.zeros((len(going), 2), dtype=np.float32)
        for k in np.flatnonzero(going).tolist():
            now, left = self._core.now, -float(observation[k, 0])  # to the goal, for a trailer of any length
            actions[k] = self._action(k, now.poses[k], float(now.velocities[k, 0, 0]), left)
        return actions

    def _action(self, k: int, poses: FloatArray, speed: float, left: float) -> tuple[float, float]:
        plan, tractor = self._plans[k], Pose2(*poses[0].tolist())
        near = plan.station
        if near is None:
            ahead = plan.stop.inverse().apply(np.array(tractor[:2])[None])[0, 0]
            if ahead < -self._CREEP:
                return 0.0, self._GAIN * (self._profile(-ahead) - speed)
            near = float(plan.reference.stations[-1]) - _BEYOND
        elif left < -self._MISSED:
            self._plans[k] = self._planned(self._goals[k], tractor, self._AGAIN)
            return 0.0, 0.0
        articulation = poses[:-1, 2] - poses[1:, 2]
        last = self._chain.last_axle(tractor, articulation.tolist())
        station = plan.reference.project(last.x, last.y, near)
        self._plans[k] = plan._replace(station=station)
        steer = self._law.steer(last, articulation, plan.reference.at(station))
        return steer / self._chain.max_steer, -self._GAIN * (self._profile(left) + speed)

    def _profile(self, left: float) -> float:
        """Speed for the distance left [m/s]."""
        return min(self._SPEED, math.sqrt(2.0 * self._GENTLE * max(left, 0.0)) + self._CREEP)

    def _planned(self, goal: Pose2, tractor: Pose2, least: float) -> _Plan:
        """Plan with the least distance straight ahead from here that will do, but at least this one [m]."""
        sharpest = self._SHARPEST * math.tan(self._chain.max_steer) / self._chain.wheelbase
        for pull in np.arange(least, self._FARTHEST + 1.0, 3.0).tolist():
            stop = tractor @ Pose2(pull, 0.0, 0.0)
            reference = _reference(self._chain, goal, _straight(self._chain, stop))
            folded = np.abs(reference.articulations).max() > self._MOST_FOLDED
            if not folded and np.abs(reference.tractor_curvatures).max() < sharpest:
                break
        return _Plan(stop, reference, None)


class OnSlope:
    """Path following of rovers that turns the body against the mean observed slip, unless not ``compensates``."""

    _APPROACH, _STEEPEST, _GAIN = 0.5, 0.6, 0.8  # [m], [rad], [1/s], as the shipped driver's
    _NEW: Final = 0.05  # share of a new slip angle in its mean, over some 2 s: 0.2 m on the path
    compensates = True

    def __init__(self, core: Any) -> None:
        """For the episodes of a core."""
        self._track = rover_geometry(core.rover).effective_track
        self._at = {feature.name: k for k, feature in enumerate(FEATURES)}

    def begin(self, observation: Features) -> None:
        """Begin without slip."""
        self._slip = np.zeros(len(observation))

    def act(self, observation: Features, going: NDArray[np.bool_]) -> Actions:
        """Actions (n, 2)."""
        row = {name: observation[:, k].astype(np.float64) for name, k in self._at.items()}
        approach = np.clip(np.arctan(-row["cross_track"] / self._APPROACH), -self._STEEPEST, self._STEEPEST)
        self._slip += (self._NEW if self.compensates else 0.0) * (row["slip_angle"] - self._slip)
        yaw_rate = row["curvature"] * row["speed"] + self._GAIN * (approach - self._slip - row["heading_error"])
        half = 0.25 * self._track * yaw_rate / row["speed"]
        return np.column_stack([0.5 - half, 0.5 + half]).astype(np.float32)


class IgnoringSlip(OnSlope):
    """The same without compensation."""

    compensates = False


def _goals(core: TractorTrailerDriving, chain: RollingChain) -> list[Pose2]:
    """Goals of the last axles in W, for trailers as in their file."""
    if not isinstance(core.aim, Goal):
        raise ValueError("drives to a gate or bay")
    ahead = -core.vehicle.units[-1].rear_x - chain.lengths[-1]
    return [Pose2(*pose) @ Pose2(ahead, 0.0, 0.0) for pose in core.aim.poses.tolist()]


_BEYOND: Final = 20.0  # straight before and after a plan [m]


def _straight(chain: RollingChain, tractor: Pose2) -> Pose2:
    """Pose of the last axle of a straight combination."""
    return chain.last_axle(tractor, [0.0] * len(chain.lengths))


def _reference(chain: RollingChain, start: Pose2, end: Pose2) -> ReverseReference:
    """Curve between two poses of the last axle, with straights before and after; station 0 is at the start."""
    far = np.column_stack([np.arange(0.5, _BEYOND, 0.5), np.zeros(round(2.0 * _BEYOND) - 1)])
    points = np.concatenate([start.apply(-far[::-1]), _curve(start, end), end.apply(far)])
    reference = ReverseReference.of(chain, points)
    return replace(reference, stations=reference.stations - far[-1, 0])


def _curve(start: Pose2, end: Pose2) -> FloatArray:
    """Points (n, 2) of a curve of seventh order between poses; curvature and its rate are 0 at both."""
    reach = math.hypot(end.x - start.x, end.y - start.y)
    t = np.linspace(0.0, 1.0, max(8, math.ceil(reach / 0.25)))[:, None]
    a, b = np.array(start[:2]), np.array(end[:2])
    u, v = (reach * np.array([math.cos(pose.psi), math.sin(pose.psi)]) for pose in (start, end))
    points: FloatArray = a + (b - a) * t**4 * (35.0 - 84.0 * t + 70.0 * t**2 - 20.0 * t**3)
    return points + u * _leaving(t) - v * _leaving(1.0 - t)


def _leaving(t: FloatArray) -> FloatArray:
    """Distance on the first tangent of a curve of seventh order, over its derivative there."""
    return t - t**4 * (20.0 - 45.0 * t + 36.0 * t**2 - 10.0 * t**3)


def _tractor(chain: RollingChain, reference: ReverseReference, ahead: float) -> FloatArray:
    """Path (n, 2) of a point of the tractor's axis, ``ahead`` [m] of its rear axle."""
    axle, psi = reference.path, reference.headings
    for k in reversed(range(len(chain.lengths))):
        towing = psi + reference.articulations[:, k]
        axle, psi = axle + chain.lengths[k] * _along(psi) - chain.hitches[k] * _along(towing), towing
    point: FloatArray = axle + ahead * _along(psi)
    return point


def _along(psi: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(psi), np.sin(psi)])


def _path(points: FloatArray) -> Path:
    """Path through close points."""
    steps = np.diff(points, axis=0)
    lengths, headings = np.hypot(*steps.T), np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    bends = np.concatenate([[0.0], np.diff(headings) / (0.5 * (lengths[1:] + lengths[:-1])), [0.0]])
    segments = [Segment(*values) for values in np.column_stack([lengths, bends[:-1], bends[1:]]).tolist()]
    return Path(Pose2(float(points[0, 0]), float(points[0, 1]), float(headings[0])), tuple(segments))


DRIVERS: Final[Mapping[str, type[OnRoad | IntoBay | OnSlope]]] = {
    "on_road": OnRoad,
    "through_gate": ThroughGate,
    "into_bay": IntoBay,
    "on_slope": OnSlope,
    "ignoring_slip": IgnoringSlip,
}
