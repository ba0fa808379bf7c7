"""Result of a trailer run in memory, with the friction of the ground around it."""

import math
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.results import metrics, swept_path
from scenarios.results.log import LOST, OK
from scenarios.results.run_summary import Numbers, Outside, Result, Summary, number, timing_numbers
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_CELLS: Final = 600  # along the longer side
_SMALLEST: Final = 0.05  # cell [m]
_BESIDE: Final = 10.0  # of the road that is in the picture [m]


class FrictionPicture(NamedTuple):
    """Friction in the middles of square cells."""

    values: FloatArray  # (rows of growing y, columns of growing x) [-]
    low: FloatArray  # (2,) lower left corner of the grid in W [m]
    high: FloatArray  # (2,) its upper right corner [m]


def friction_picture(surface: Surface, road: FloatArray) -> FrictionPicture | None:
    """The friction around a road (n, 2) [m]; None if it is the same everywhere there."""
    if surface.is_uniform:
        return None
    low, high = road.min(axis=0) - _BESIDE, road.max(axis=0) + _BESIDE
    cell = max(_SMALLEST, float((high - low).max()) / _CELLS)
    columns, rows = np.ceil((high - low) / cell).astype(int).tolist()
    x, y = (start + cell * (np.arange(n) + 0.5) for start, n in zip(low, (columns, rows), strict=True))
    values = surface.friction_at(*np.meshgrid(x, y))
    if np.ptp(values) == 0.0:
        return None
    return FrictionPicture(values, low, low + cell * np.array([columns, rows]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFrame:
    """A picture of the left camera for reports and videos; the odometry works on the uncompressed images."""

    tick: int
    jpeg: bytes  # colour or grey
    tracks: NDArray[np.float32]  # (m, 4) of features: u, v in the previous, u, v in this left image [px]
    matches: int
    inliers: int


class MountedCamera(NamedTuple):
    """The left camera of a stereo pair and its place, for drawings."""

    unit: int  # index of the unit that carries it
    calibration: StereoCalibration


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedTrailer:
    """A trailer whose off-tracking is estimated and judged; its signals end with its name."""

    name: str
    follow_distance: float  # hitch to follow point [m]
    n_steered: int  # number of its steered axles
    max_steer: float | None  # limit of their actuators [rad]; None: none is steered


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunResult(Result):
    """The result of a combination's run."""

    kind: ClassVar[str] = "trailer"

    units: tuple[swept_path.UnitOutline, ...]  # tractor first
    trailers: tuple[JudgedTrailer, ...]  # front to rear; the last is the last unit
    road: FloatArray  # (n, 2) centre line [m]
    road_half_width: float | FloatArray  # everywhere, or (n, 2) to the left and right of its points [m]
    lanes: FloatArray | None = None  # (n, 2) from its points to the left and right border of the lane [m]
    things: tuple[FloatArray, ...] = ()  # outlines (m, 2) of kerbs, islands and signals of its map [m]
    friction: FrictionPicture | None = None  # around the road; None: one friction everywhere
    road_known: bool = True  # False for a recorded drive: the road above is only drawn
    circle_centre: tuple[float, float] | None  # of the course, if it is a roundabout [m]
    arcs: tuple[swept_path.TurnArc, ...] = ()  # turns of the course
    path_deviation: float | None = None  # largest distance of the points of a course's file from its path [m]
    frames: tuple[CameraFrame, ...]  # of the last trailer; empty without cameras
    cameras: tuple[MountedCamera, ...] = ()  # of all trailers
    outside: Outside | None = None  # exchange with a bench; None: there was none

    def all_warnings(self) -> tuple[str, ...]:
        """Lines about what is doubtful: of the run itself, of its pace, and of what came from outside."""
        return (*Result.all_warnings(self), *(self.outside.warnings if self.outside else ()))

    def summary(self) -> Summary:
        """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""
        worst = _worst(self).name
        numbers: Summary = {
            "outcome": self.outcome,
            "scenario": self.scenario,
            "seed": self.seed,
            "warnings": list(self.all_warnings()),
            "off_tracking": _off_tracking(self, worst),
            "swept_path": _swept_path(swept(self)),
            "road": _road(self),
            "steer": _steer(self, worst),
            "tyres": {"friction_used_max": number(metrics.peak(self.signal("friction_used_max")))},
            "odometry": _odometry(self),
            "timing": timing_numbers(self.timing),
        }
        if self.paced is not None:
            numbers["paced"] = self.paced.numbers()
        if self.outside is not None:
            numbers["outside"] = self.outside.numbers()
        if self.path_deviation is not None:
            place = {name: value for name, value in self.placement.items() if not isinstance(value, str)}
            numbers["course"] = {"path_deviation_m": number(self.path_deviation), **place}
        return numbers | ({"trailers": trailer_summaries(self)} if len(self.trailers) > 1 else {})

    @property
    def trailer(self) -> swept_path.UnitOutline:
        """Outline of the last trailer."""
        return self.units[-1]

    @property
    def leader(self) -> str:
        """What leads the last trailer, in words: its hitch, or the front axle of a vehicle that tows nothing."""
        return "hitch" if len(self.units) > 1 else "front axle"

    @property
    def steered_name(self) -> str:
        """The axles that a law turns, in words."""
        return "trailer axle" if len(self.units) > 1 else "steered rear axle"

    @property
    def follow_distance(self) -> float:
        """Hitch to follow point of the last trailer [m]."""
        return self.trailers[-1].follow_distance

    @property
    def trailer_steer_limit(self) -> float | None:
        """Limit of the last trailer's actuators [rad]; None: none is steered."""
        return self.trailers[-1].max_steer

    def signal(self, name: str) -> FloatArray:
        """The signal over time, shape (n_rows,); NaN throughout if this run has none of that name."""
        return self.log[name] if name in self.log else np.full(len(self.log), np.nan)

    def steer_signals(self, trailer: str = "", *, demands: bool = False) -> tuple[str, ...]:
        """Names of the signals of a trailer's steer angles or demands, front to rear; by default the last's."""
        judged = next((one for one in self.trailers if one.name == trailer), self.trailers[-1])
        ending = f"command_{judged.name}" if demands else judged.name
        return tuple(f"steer_trailer_{k}_{ending}" for k in range(1, judged.n_steered + 1))


def error_of_estimate(result: RunResult, trailer: str = "") -> FloatArray:
    """Estimated minus true off-tracking at the time of capture [m], (n_rows,), NaN elsewhere; by default the last's."""
    name = trailer or result.trailers[-1].name
    estimate, true, health = (
        result.signal(f"{quantity}_{name}") for quantity in ("off_tracking_estimate", "off_tracking_true", "health")
    )
    return metrics.estimate_error(estimate, true, health)


def trailer_summaries(result: RunResult) -> dict[str, Numbers]:
    """Off-tracking and steering of every judged trailer by its name, front to rear."""
    return {
        trailer.name: _off_tracking(result, trailer.name)
        | {f"steer_{key}": value for key, value in _steer(result, trailer.name).items()}
        for trailer in result.trailers
    }


def _worst(result: RunResult) -> JudgedTrailer:
    """The trailer with the largest off-tracking; of equal ones the last."""
    peaks = [np.nan_to_num(metrics.peak(result.signal(f"off_tracking_true_{t.name}"))) for t in result.trailers]
    return result.trailers[len(peaks) - 1 - int(np.argmax(peaks[::-1]))]


def swept(result: RunResult) -> swept_path.SweptPath:
    """Swept path of the run; NaN throughout if it ended before the vehicle had moved."""
    if len(result.log) < 2:
        return swept_path.SweptPath(math.nan, math.nan, math.nan, math.nan, math.nan)
    return swept_path.swept_path(
        result.units, tuple(unit.poses(result.log) for unit in result.units), result.circle_centre, result.arcs
    )


def _off_tracking(result: RunResult, trailer: str) -> Numbers:
    true, error = result.signal(f"off_tracking_true_{trailer}"), error_of_estimate(result, trailer)
    reference, std = (result.signal(f"off_tracking_{kind}_{trailer}") for kind in ("reference", "std"))
    health = result.signal(f"health_{trailer}")
    believed = np.where(health == OK, error, np.nan)
    return {
        "true_rms_m": number(metrics.rms(true)),
        "true_max_m": number(metrics.peak(true)),
        "true_max_time_s": number(metrics.time_of_peak(true, result.signal("time"))),
        "estimate_error_rms_m": number(metrics.rms(error)),
        "estimate_error_max_m": number(metrics.peak(error)),
        "valid_fraction": number(metrics.valid_fraction(health, true)),
        "reference_error_rms_m": number(metrics.rms(reference - true)),
        "estimate_against_reference_rms_m": number(metrics.rms(error + true - reference)),
        "within_2_5_sigma": number(metrics.within_sigmas(error, std)),
        "ok_within_2_5_sigma": number(metrics.within_sigmas(believed, std)),
        "nees_mean": number(metrics.nees(error, std)),
        **_bridged(result.signal(f"bridged_{trailer}")),
    }


def _bridged(seconds: FloatArray) -> Numbers:
    """Share of the estimates that are bridged by dead reckoning, and the longest bridge."""
    delivered = seconds[np.isfinite(seconds)]
    return {
        "bridged_fraction": number(float(np.mean(delivered > 0.0)) if delivered.size else math.nan),
        "longest_bridge_s": number(metrics.peak(delivered)),
    }


def _swept_path(path: swept_path.SweptPath) -> Numbers:
    names = ("max_width", "min_inner_radius", "tail_swing", "tail_swing_entry", "tail_swing_exit")
    return {f"{name}_m": number(getattr(path, name)) for name in names}


def clearances(result: RunResult) -> dict[str, swept_path.Clearance]:
    """Clearance over time of the wheels inside the road, and of the bodies inside the lane if there is one."""
    if not result.road_known:
        return {}
    poses = [unit.poses(result.log) for unit in result.units]
    edges = swept_path.RoadEdges(result.road, result.road_half_width)
    found = {"wheel": swept_path.wheel_clearance(edges, result.units, poses)}
    if result.lanes is not None:
        found["lane"] = swept_path.body_clearance(swept_path.RoadEdges(result.road, result.lanes), result.units, poses)
    return found


def _road(result: RunResult) -> Numbers:
    """Least clearances to the left and right, each with its time and place."""
    numbers: Numbers = {}
    found = clearances(result)
    for kind in dict.fromkeys(("wheel", *found)):
        for k, side in enumerate(("left", "right")):
            values = [math.nan] * 4
            if kind in found and (row := found[kind].least(k)) is not None:
                values = [found[kind].distance[row, k], result.log["time"][row], *found[kind].place[row, k]]
            names = (f"{kind}_clearance_{side}_{ending}" for ending in ("m", "time_s", "x_m", "y_m"))
            numbers |= {name: number(value) for name, value in zip(names, values, strict=True)}
    return numbers


def _steer(result: RunResult, trailer: str) -> Numbers:
    angles = [result.log[name] for name in result.steer_signals(trailer)]
    largest = max((metrics.peak(angle) for angle in angles), default=math.nan)
    fastest = max((metrics.peak(metrics.rate(angle, result.log["time"])) for angle in angles), default=math.nan)
    return {"max_deg": number(math.degrees(largest)), "max_rate_deg_s": number(math.degrees(fastest))}


def _odometry(result: RunResult) -> Numbers:
    health = result.signal("odometry_health")
    captures = np.isfinite(health)
    drift = metrics.odometry_drift(
        result.trailer.poses(result.log)[captures],
        np.column_stack([result.signal(f"odometry_{part}")[captures] for part in ("dx", "dy", "dpsi")]),
        health[captures] >= LOST,
        result.follow_distance,
    )
    return {
        "matches_mean": number(metrics.mean(result.signal("matches"))),
        "inliers_mean": number(metrics.mean(result.signal("inliers"))),
        "lost_frames": int(np.sum(health[captures] >= LOST)) if captures.any() else None,
        "longest_loss_s": number(metrics.longest_loss(health, result.log["time"])),
        "drift_percent": number(100.0 * metrics.mean(drift)),
    }
