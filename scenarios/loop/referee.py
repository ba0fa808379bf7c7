"""Mishaps of a combination, from ground truth: jackknifed, rolled over, left the road."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from scenarios.results.log import Log
from scenarios.results.road_edges import RoadEdges
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

Outcome = Literal["jackknifed", "rolled over", "left the road"]

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
        self, vehicle: Vehicle, road: FloatArray | None = None, road_half_width: float | FloatArray = math.inf
    ) -> None:
        """Create a referee; ``road`` is a centre line (n, 2) [m] with points no farther apart than the road is wide.

        Its half width is one number, or (n, 2) to the left and right of the points of the line [m].
        """
        tractor = vehicle.units[0]
        self._wheels = np.array([(axle.x, side * 0.5 * axle.track) for axle in tractor.axles for side in (1, -1)])
        self._reach = float(np.max(np.hypot(*self._wheels.T)))  # of the wheels from the tractor's origin [m]
        self._edges = None if road is None else RoadEdges(road, road_half_width)
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
        memory = memory._replace(lifted=since)
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
        off = bool(np.any(edges.distance(wheels)[0] < 0.0))
        return memory._replace(x=x, y=y, psi=psi, room=edges.room(wheels)), "left the road" if off else None


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
