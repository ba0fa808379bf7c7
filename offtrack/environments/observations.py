"""Observations of trailers without rendering (ground truth, surrogate), and the past paths of their hitches.

Points of a path are equally spaced along it. Each trailer remembers the two points around its follow point and searches
from there. Where a path crosses itself, it stays on its branch.
"""

import math
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer_steering.policy import AHEAD, feature_names
from offtrack.environments.core import Feature, Lanes, Observation, observation_space, within
from offtrack.environments.rewards import Circumstances
from offtrack.reports.canvas import Picture
from scenarios.assembly.surrogate import Estimate, Surrogate, SurrogateParameters
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchMotion
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_SPACING = 0.1  # [m]; the parabola through such points on a circle of 10 m is a micrometre off
_LONGEST = 3.0  # path kept, in follow distances: half a circle that just reaches the follow point has pi / 2
_FOUR = np.arange(-1, 3)[:, None]  # points around the follow point, from the one behind it
_MIN_ALONG = 1e-6  # a path perpendicular to the trailer has no unique point at the follow point [m]
_MAX_MOVES = 8  # points that a follow point can pass in a control step: 40 m/s


class PathOffset(NamedTuple):
    """Lateral offsets of n hitch paths from the follow points, in the trailers' frames."""

    offset: FloatArray  # (n,) off-tracking, + if the path lies left of the follow point [m]
    direction: FloatArray  # (n,) of travel on the path, + left of the trailer's axis [rad]
    ahead: FloatArray  # (n, 3) lateral position of the path ``AHEAD`` of the follow point, along its arc [m]


class Mark(NamedTuple):
    """A moment of n paths; ``HitchPaths.behind`` returns the path as it was then."""

    poses: FloatArray  # (n, 3) of the trailers, x y [m], psi [rad]
    n_points: NDArray[np.intp]  # (n,) until then


class HitchPaths:
    """Paths of n hitches."""

    def __init__(self, n: int, longest_follow_distance: float) -> None:
        """For follow distances up to this one [m]."""
        needed = _LONGEST * longest_follow_distance / _SPACING
        self._size = 1 << math.ceil(math.log2(needed))
        self._points = np.zeros(n * self._size, dtype=np.complex128)  # of one path after the other
        self._row = np.arange(n) * self._size
        self._count = np.zeros(n, dtype=np.intp)  # of points so far; the newest is the last
        self._index = np.zeros(n, dtype=np.intp)  # the last point behind the follow point
        self._last = np.zeros(n, dtype=np.complex128)  # latest position of the hitch
        self._distance = np.zeros(n)  # since the newest point [m]
        self._follow = np.ones(n)
        self._ahead = np.zeros((n, len(AHEAD)), dtype=np.intp)
        self._poses = np.zeros((n, 3))

    def begin(self, lanes: NDArray[np.intp], poses: FloatArray, follow_distance: FloatArray) -> None:
        """Begin with straight paths behind these trailers, poses x y psi (k, 3)."""
        here, heading = poses[:, 0] + 1j * poses[:, 1], np.exp(1j * poses[:, 2])
        back = _SPACING * np.arange(self._size - 1, -1, -1)
        self._points.reshape(-1, self._size)[lanes] = here[:, None] - heading[:, None] * back
        self._count[lanes] = self._size
        self._index[lanes] = self._size - 1 - np.ceil(follow_distance / _SPACING).astype(np.intp)
        self._last[lanes], self._distance[lanes] = here, 0.0
        self._follow[lanes] = follow_distance
        self._ahead[lanes] = np.rint(follow_distance[:, None] * AHEAD / _SPACING)

    def step(self, poses: FloatArray) -> PathOffset:
        """Extend all paths to the trailers' poses x y psi (n, 3); return their offsets."""
        here = poses[:, 0] + 1j * poses[:, 1]
        self._poses = poses
        self._extend(here)
        turned = np.exp(-1j * poses[:, 2])
        around = self._around_follow_point(here, turned)
        return self._offset(around, here, turned)

    def mark(self) -> Mark:
        """Mark of this moment."""
        return Mark(self._poses.copy(), self._count.copy())

    def behind(self, lane: int, mark: Mark, reach: float) -> FloatArray:
        """Path of one hitch as it was at a recent moment, (k, 2), newest first, in the trailer's frame [m].

        It begins at the hitch and ends ``reach`` [m] behind it along the trailer's axis, or where the points end.
        """
        x, y, psi = mark.poses[lane].tolist()
        numbers = np.arange(mark.n_points[lane] - 1, self._count[lane] - self._size, -1)
        points = (self._points[self._row[lane] + (numbers & (self._size - 1))] - complex(x, y)) * np.exp(-1j * psi)
        beyond = np.flatnonzero(points.real < -reach)
        points = points[: beyond[0] if len(beyond) else len(points)]
        return np.concatenate([np.zeros((1, 2)), np.column_stack([points.real, points.imag])])

    def _extend(self, here: NDArray[np.complex128]) -> None:
        step = here - self._last
        distance = np.abs(step)
        before = self._distance.copy()
        self._distance = before + distance
        while True:
            (full,) = (self._distance >= _SPACING).nonzero()
            if not len(full):
                break
            part = (_SPACING - before[full]) / distance[full]
            self._points[self._row[full] + (self._count[full] & (self._size - 1))] = (
                self._last[full] + part * step[full]
            )
            self._count[full] += 1
            self._distance[full] -= _SPACING
            before[full] -= _SPACING
        self._last = here

    def _around_follow_point(
        self, here: NDArray[np.complex128], turned: NDArray[np.complex128]
    ) -> NDArray[np.complex128]:
        """Four points in the trailers' frames, (4, n); the follow point lies between the middle two."""
        newest, oldest = self._count - 3, self._count - (self._size - 1)
        for _ in range(_MAX_MOVES):
            four = (self._points[self._row + ((self._index + _FOUR) & (self._size - 1))] - here) * turned
            move = (four[2].real <= -self._follow).astype(np.intp) - (four[1].real > -self._follow)
            moved = np.minimum(np.maximum(self._index + move, oldest), newest)
            if (moved == self._index).all():
                break
            self._index = moved
        return four

    def _offset(
        self, four: NDArray[np.complex128], here: NDArray[np.complex128], turned: NDArray[np.complex128]
    ) -> PathOffset:
        a, b = four[1], four[2]
        along = b.real - a.real
        along = np.where(np.abs(along) < _MIN_ALONG, _MIN_ALONG, along)
        t = (-self._follow - a.real) / along
        t = np.minimum(np.maximum(t, 0.0), 1.0)
        # The parabola between a and b falls short of their chord by t (1 - t) of the bend, along and across.
        bend = 0.25 * (four[0] - a - b + four[3])
        t = t + t * (1.0 - t) * bend.real / along
        offset = a.imag + t * (b.imag - a.imag) - t * (1.0 - t) * bend.imag
        onward = b - a - (1.0 - 2.0 * t) * bend
        further = self._row[:, None] + ((self._index[:, None] + self._ahead) & (self._size - 1))
        ahead = ((self._points[further] - here[:, None]) * turned[:, None]).imag
        return PathOffset(offset, np.arctan2(onward.imag, onward.real), ahead)


_ARTICULATION, _GYRO = math.radians(0.1), math.radians(0.1)  # biases as in that module, 1 sigma [rad], [rad/s]


class Encoders:
    """Articulation encoders and gyros of n vehicles."""

    def __init__(self, n: int, n_units: int) -> None:
        """Without errors until they ``begin``."""
        self._articulation, self._gyro = np.zeros((n, n_units - 1)), np.zeros((n, n_units))

    def begin(self, lanes: NDArray[np.intp], generators: list[np.random.Generator], scale: FloatArray) -> None:
        """Draw errors of this ``scale`` (k,) for these vehicles."""
        n_hitches, n_units = self._articulation.shape[1], self._gyro.shape[1]
        drawn = scale[:, None] * np.array([rng.standard_normal(n_hitches + n_units) for rng in generators])
        self._articulation[lanes] = _ARTICULATION * drawn[:, :n_hitches]
        self._gyro[lanes] = _GYRO * drawn[:, n_hitches:]

    def read(self, motion: BatchMotion) -> tuple[FloatArray, FloatArray]:
        """Articulation (n, N - 1) [rad] and yaw rates (n, N) [rad/s]."""
        psi = motion.poses[:, :, 2]
        return psi[:, :-1] - psi[:, 1:] + self._articulation, motion.velocities[:, :, 2] + self._gyro


def features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """All entries of the observation, as a policy in the loop gets them."""
    names = feature_names(n_steered, [unit.name for unit in vehicle.units])
    return tuple(
        Feature(name, *next(kind for start, kind in _KINDS.items() if name.startswith(start))) for name in names
    )


def own_features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """Features next to an image: its age, and the signals of the combination's own sensors."""
    entries = features(vehicle, n_steered)
    names = [feature.name for feature in entries]
    return (entries[names.index("age")], *entries[names.index("usable") + 1 :])


_KINDS: Final = {  # prefix of the name: unit and limit
    "off_tracking": ("m", 10.0),
    "path_direction": ("rad", 3.2),
    "path_": ("m", 20.0),
    "hitch_v_": ("m/s", 40.0),
    "trailer_yaw_rate": ("rad/s", 5.0),
    "age": ("s", 60.0),
    "usable": ("-", 1.0),
    "steer_": ("rad", 1.6),
    "speed": ("m/s", 40.0),
    "articulation_": ("rad", 3.2),
    "yaw_rate_": ("rad/s", 5.0),
    "follow_distance": ("m", 50.0),
}


ObservationKind = Literal["estimate", "surrogate", "truth", "camera"]

_FRAME, _LATENCY = 100, 100  # of cameras and estimator, as in the scenarios [ticks]


class EpisodeStart(NamedTuple):
    """Episodes that begin."""

    lanes: Lanes  # (k,)
    generators: list[np.random.Generator]  # (k,)
    course: Lanes  # (k,) numbers of their courses
    drawn: Circumstances
    follow_distance: FloatArray  # (k,) [m]


class TrueOrSurrogate:
    """Observations from ground truth or from a surrogate of an estimator, with the combination's own sensors."""

    def __init__(self, vehicle: Vehicle, n: int, period: float, surrogate: SurrogateParameters | None) -> None:
        """For control steps of ``period`` [s]; without a surrogate, ground truth."""
        self._n_steered = len(vehicle.units[-1].steered_axles)
        self.features = features(vehicle, self._n_steered)
        self.observation_space = observation_space(self.features)
        self._surrogate: Surrogate | None = None
        if surrogate is not None:
            step = to_ticks(period, "control period")
            self._surrogate = Surrogate(surrogate, n, step=step, period=_FRAME, latency=_LATENCY)
        self._encoders, self._follow_distance = Encoders(n, len(vehicle.units)), np.ones(n)
        self._estimate: Estimate | None = None  # before the first episode
        self._motion: BatchMotion | None = None

    def begin(self, start: EpisodeStart, motion: BatchMotion, offset: PathOffset) -> None:
        """Begin with an exact estimate: the buffer has filled on the way to the start."""
        lanes, generators, error = start.lanes, start.generators, start.drawn.sensor_error
        self._follow_distance[lanes], self._motion = start.follow_distance, motion
        self._encoders.begin(lanes, generators, 0.0 * error if self._surrogate is None else error)
        truth = _true_estimate(motion, offset)
        if self._surrogate is not None:
            self._surrogate.begin(lanes, generators, error, start.follow_distance, truth)
        if self._estimate is None:
            self._estimate = truth
        for estimated, true in zip(self._estimate, truth, strict=True):
            estimated[lanes] = true[lanes]

    def step(self, motion: BatchMotion, offset: PathOffset) -> None:
        """Advance by one control step."""
        self._motion, truth = motion, _true_estimate(motion, offset)
        self._estimate = truth if self._surrogate is None else self._surrogate.step(truth)

    def observe(self) -> Observation:
        """Features (n, n_features) as ``features`` lists them."""
        estimate, motion = self._estimate, self._motion
        if estimate is None or motion is None:
            raise ValueError("no observation before an episode begins: reset first")
        articulation, yaw_rates = self._encoders.read(motion)
        values = np.concatenate(
            [
                estimate.offset[:, None],
                estimate.direction[:, None],
                estimate.ahead,
                estimate.velocity,
                estimate.age[:, None],
                estimate.usable[:, None],
                motion.steer[:, -self._n_steered :],
                motion.steer[:, :1],
                motion.velocities[:, 0, :1],
                articulation,
                yaw_rates,
                self._follow_distance[:, None],
            ],
            axis=1,
        )
        return within(values, self.observation_space)

    def view(self, lane: int) -> Picture | None:
        """None: there is no camera."""
        return None

    def close(self) -> None:
        """Nothing is open."""


def _true_estimate(motion: BatchMotion, offset: PathOffset) -> Estimate:
    """Ground truth in the form of an estimate."""
    n = len(offset.offset)
    velocity = motion.velocities[:, -1]
    return Estimate(offset.offset, offset.direction, offset.ahead, velocity, np.zeros(n), np.ones(n, dtype=bool))
