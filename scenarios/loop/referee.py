"""Judge a trailer's run: end of its course or recorded drive, a mishap, or a vehicle that is stuck."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from controllers.driver import DriverTrace
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly
from scenarios.results.log import Log
from scenarios.results.swept_path import RoadEdges
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2

Outcome = Literal["jackknifed", "rolled over", "left the road", "left the lane"]

# At a right angle the pull at the hitch has no component along the unit behind. Beyond it, driving forward rolls that
# unit's axles backwards, and no driver can pull the combination straight any more.
FOLDED: Final = 0.5 * math.pi  # articulation [rad]

# The wheels of one side carry at most a hundredth of the load: the plant keeps some newtons on a lifted wheel.
LIFTED: Final = 0.98  # load transfer [-]

# A wheel that skips over a bump is no roll-over. A laden body with its centre of gravity 2.2 m from its outer wheels
# and a radius of gyration of 1.1 m tips over them with a time constant of sqrt((1.1^2 + 2.2^2) / (9.81 * 2.2)) s. In a
# quick lane change a body with one side in the air comes back; it falls where its centre of gravity is beyond its
# outer wheels. A body that rolls by gradients never gets there: one side in the air for that time is a roll-over.
FALLING: Final = 0.5  # least time with one side in the air [s]


class RefereeMemory(NamedTuple):
    """State between two steps."""

    lifted: int | None = None  # tick since which one side of a unit is in the air; None if none is
    x: float = 0.0  # pose of the tractor when its wheels were last compared with the road [m], [m], [rad]
    y: float = 0.0
    psi: float = 0.0
    room: float = 0.0  # travel from there that leaves every wheel on the road [m]


class Referee:
    """Detects mishaps of a combination; leaving the road is judged by the tractor, if a road is given.

    Trailers may leave the road: a long one cuts in by metres on a roundabout and may use its inside.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        road: FloatArray | None = None,
        road_half_width: float | FloatArray = math.inf,
        paved: FloatArray | None = None,
    ) -> None:
        """Create a referee; ``road`` is a centre line (n, 2) [m] with points no farther apart than the road is wide.

        Its half width is one number, or (n, 2) to the left and right of the points of the line [m]. Where it is that of
        a lane, ``paved`` (n, 2) is that of the road.
        """
        tractor = vehicle.units[0]
        self._wheels = np.array([(axle.x, side * 0.5 * axle.track) for axle in tractor.axles for side in (1, -1)])
        self._reach = float(np.max(np.hypot(*self._wheels.T)))  # of the wheels from the tractor's origin [m]
        self._edges = None if road is None else RoadEdges(road, road_half_width)
        self._paved = None if road is None or paved is None else RoadEdges(road, paved)
        reach = [0.5 * max(axle.track for axle in unit.axles) for unit in vehicle.units]
        tipping = np.arctan2(reach, [unit.cg_height for unit in vehicle.units])
        self._tipping: FloatArray = tipping if vehicle.has_springs else np.zeros(len(tipping))  # lean of a body [rad]

    def init(self) -> RefereeMemory:
        """Memory at the start: no wheel is in the air."""
        return RefereeMemory()

    def step(self, memory: RefereeMemory, truth: Truth) -> tuple[RefereeMemory, Outcome | None]:
        """New memory and outcome of the run; None if it continues."""
        lifted, since = any(abs(transfer) >= LIFTED for transfer in truth.load_transfer.tolist()), None
        if lifted:
            since = truth.tick if memory.lifted is None else memory.lifted
        memory = memory if since == memory.lifted else memory._replace(lifted=since)
        if any(abs(ahead - behind) >= FOLDED for ahead, behind in pairwise(truth.poses[:, 2].tolist())):
            return memory, "jackknifed"
        if since is not None and (truth.tick - since) * TICK >= FALLING and self._tips(truth):
            return memory, "rolled over"
        if self._edges is None:
            return memory, None
        return self._on_the_road(memory, self._edges, truth)

    def _tips(self, truth: Truth) -> bool:
        """True if a body leans so far that its weight does not bring it back."""
        lean = np.arctan2(truth.bodies[:, 2, 1], truth.bodies[:, 2, 2])
        return bool(np.any(np.abs(lean) >= self._tipping))

    def _on_the_road(
        self, memory: RefereeMemory, edges: RoadEdges, truth: Truth
    ) -> tuple[RefereeMemory, Outcome | None]:
        """The road is left if a wheel of the tractor stands beyond its edge; compared where that is possible."""
        x, y, psi = truth.poses[0].tolist()
        if math.hypot(x - memory.x, y - memory.y) + self._reach * abs(psi - memory.psi) < memory.room:
            return memory, None
        c, s = math.cos(psi), math.sin(psi)
        wheels = np.array([x, y]) + self._wheels @ np.array([[c, s], [-s, c]])
        outcome: Outcome | None = None
        if np.any(edges.distance(wheels)[0] < 0.0):
            on_road = self._paved is not None and bool(np.all(self._paved.distance(wheels)[0] >= 0.0))
            outcome = "left the lane" if on_road else "left the road"
        return memory._replace(x=x, y=y, psi=psi, room=edges.room(wheels)), outcome


def lift_warnings(vehicle: Vehicle, log: Log) -> tuple[str, ...]:
    """A line for every unit that had one side in the air for ``FALLING`` or longer, fallen or not."""
    lines = []
    for unit in vehicle.units:
        lifted = (np.abs(log[f"load_transfer_{unit.name}"]) >= LIFTED).astype(np.int8)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], lifted, [0]])))
        for start, end in zip(log["time"][edges[::2]], log["time"][edges[1::2] - 1], strict=True):
            if end - start >= FALLING:
                lines.append(f"{unit.name}: the wheels of one side carry nothing from {start:.1f} to {end:.1f} s")
                break
    return tuple(lines)


# Lags of driveline, brakes and steering end within a second or two. A miss that lasts longer leads elsewhere: 20 % of
# 80 km/h are 22 m after 5 s, more than a vehicle's length.
HELD: Final = 5.0  # time that a quantity is missed before the run ends [s]
HELD_AT_END: Final = 1.0  # the same, at the end of the recording [s]
SHARE: Final = 0.2  # of the recorded speed or steer angle that may be missed all the time [-]
SPEED: Final = 1.0  # added to it: noise of a recorded speed at walking pace [m/s]
STEER: Final = math.radians(2.0)  # added to it: play and offset of a recorded steering [rad]

# A recorded acceleration is applied open loop. Gravity on a 10 % slope, or rolling resistance, may change it.
ACCELERATION: Final = 1.5  # mean difference over HELD [m/s2]
_AT_REST: Final = 0.1  # brakes do not move a vehicle backwards [m/s]


class RecordedDrive:
    """Finds out whether a vehicle does what a recording asks for."""

    def __init__(self, trace: DriverTrace) -> None:
        self._trace = trace
        self._since: dict[str, int] = {}  # tick since which a quantity has been missed
        self._before: tuple[int, float] | None = None  # tick and speed [m/s] of the step before
        self._lag = 0.0  # recorded less driven change of speed, forgotten with the time constant HELD [m/s]

    def outcome(self, truth: Truth, *, ends: bool) -> str | None:
        """The quantity that is missed for too long, in words; None if the vehicle does as recorded."""
        self._since = {name: self._since.get(name, truth.tick) for name in self._missed(truth)}
        held = HELD_AT_END if ends else HELD
        late = [name for name, since in self._since.items() if (truth.tick - since) * TICK >= held]
        return f"did not reach the recorded {late[0]}" if late else None

    def _missed(self, truth: Truth) -> Iterator[str]:
        trace, now, v_x = self._trace, truth.tick * TICK, float(truth.velocities[0, 0])
        steer = float(np.interp(now, trace.time, trace.steer))
        if not abs(truth.steer[0] - steer) <= STEER + SHARE * abs(steer):
            yield "steer angle"
        if trace.speed is not None:
            speed = float(np.interp(now, trace.time, trace.speed))
            if not abs(v_x - speed) <= SPEED + SHARE * abs(speed):
                yield "speed"
        elif trace.acceleration is not None and not self._keeps_up(trace.acceleration, truth.tick, v_x):
            yield "acceleration"

    def _keeps_up(self, recorded: FloatArray, tick: int, v_x: float) -> bool:
        before, v_before = self._before or (tick, v_x)
        self._before = tick, v_x
        span = (tick - before) * TICK
        acceleration = float(np.interp(tick * TICK, self._trace.time, recorded))
        asked = max(acceleration, 0.0) if abs(v_x) < _AT_REST else acceleration
        self._lag += asked * span - (v_x - v_before) - self._lag * span / HELD
        return abs(self._lag) <= ACCELERATION * HELD


_PATIENCE = 1.5  # longest duration of a run over the planned one; beyond it the vehicle is stuck
_GRACE = 10.0  # added for a start on a slope [s]
_COMPARED = 0.5  # travel between two comparisons with the course, at most: the projection finds its branch [m]


class CourseJudge:
    """Ends a run at the end of its course or recorded drive, at a mishap, or when the vehicle is stuck."""

    def __init__(self, parts: Assembly) -> None:
        road = None if parts.trace else parts.course.centreline  # the road of a recorded drive is unknown
        self._referee = Referee(parts.vehicle, road, parts.course.road_half_width, parts.course.paved)
        self._memory = self._referee.init()
        tractor = parts.vehicle.units[0]
        # A tractor on another part of the road, after a crossing or the wrong exit, is not on its course any more. On
        # the right part of the road every point of the tractor is nearer to the path than this.
        self._astray = float(np.max(parts.course.road_half_width)) + tractor.front_x - tractor.rear_x  # [m]
        self._recorded = RecordedDrive(parts.trace) if parts.trace else None
        self._parts = parts
        self._station = 0.0  # of the guided point along the course [m]
        self._last_place = (math.nan, math.nan)  # where it was when it was last compared with the course [m]
        self._safe_travel = 0.0  # travel from there that neither ends nor leaves the course [m]
        self._elapsed = 0.0  # [s]

    @property
    def progress(self) -> float:
        """Share of the course, or of a recorded drive, that is done, 0 to 1."""
        parts = self._parts
        done = self._elapsed / parts.duration if parts.trace else self._station / parts.course.length
        return min(1.0, done)

    def outcome(self, truth: Truth) -> str | None:
        """Outcome of the run; None if it continues."""
        self._elapsed = (truth.tick + LOG_PERIOD) * TICK
        self._memory, mishap = self._referee.step(self._memory, truth)
        if mishap is not None:
            return mishap
        parts, course = self._parts, self._parts.course
        if self._recorded:
            ends = self._elapsed >= parts.duration
            return self._recorded.outcome(truth, ends=ends) or ("completed" if ends else None)
        point = Pose2(*truth.poses[0].tolist()) @ Pose2(*course.reference, 0.0)
        if not math.hypot(point.x - self._last_place[0], point.y - self._last_place[1]) < self._safe_travel:
            self._station = course.path.project(point.x, point.y, self._station)
            on_path, end = course.path.pose(self._station), course.length - 1e-6
            deviation = math.hypot(point.x - on_path.x, point.y - on_path.y)
            if deviation > self._astray:
                return "left the road"
            if self._station >= end:
                return "completed"
            # inside a bend the station grows by up to twice the travel, as `project` limits it
            self._last_place = point[:2]
            self._safe_travel = min(_COMPARED, self._astray - deviation, 0.5 * (end - self._station))
        return "timed out" if self._elapsed > _GRACE + _PATIENCE * parts.duration else None
