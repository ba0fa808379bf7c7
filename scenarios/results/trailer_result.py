"""Result of a trailer run in memory, with the friction of the ground around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenarios.results import metrics
from scenarios.results.log import Log
from scenarios.results.run_inputs import RunInputs
from scenarios.results.summary_numbers import Outside, Paced, Timing
from scenarios.results.swept_path import TurnArc, UnitOutline
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
class RunResult:
    """The result of a finished trailer run."""

    scenario: str  # name
    scenario_toml: str  # resolved: runs again identically
    seed: int
    outcome: str  # "completed", "diverged", "failed: …", …
    log: Log
    units: tuple[UnitOutline, ...]  # tractor first
    trailers: tuple[JudgedTrailer, ...]  # front to rear; the last is the last unit
    road: FloatArray  # (n, 2) centre line [m]
    road_half_width: float | FloatArray  # everywhere, or (n, 2) to the left and right of its points [m]
    friction: FrictionPicture | None = None  # around the road; None: one friction everywhere
    road_known: bool = True  # False for a recorded drive: the road above is only drawn
    circle_centre: tuple[float, float] | None  # of the course, if it is a roundabout [m]
    arcs: tuple[TurnArc, ...] = ()  # turns of the course
    path_deviation: float | None = None  # largest distance of the points of a course's file from its path [m]
    timing: Timing
    frames: tuple[CameraFrame, ...]  # of the last trailer; empty without cameras
    cameras: tuple[MountedCamera, ...] = ()  # of all trailers
    manifest: Mapping[str, str]  # OpenGL renderer and hash of the sensor images
    warnings: tuple[str, ...] = ()  # of what is doubtful about the run, a line each
    traceback: str = ""  # of the exception that ended the run
    inputs: RunInputs = field(default_factory=RunInputs)  # files and own modules that the scenario names
    paced: Paced | None = None  # deadlines kept and missed; None: the run was not paced
    outside: Outside | None = None  # exchange with a bench; None: there was none

    @property
    def trailer(self) -> UnitOutline:
        """Outline of the last trailer."""
        return self.units[-1]

    @property
    def follow_distance(self) -> float:
        """Hitch to follow point of the last trailer [m]."""
        return self.trailers[-1].follow_distance

    @property
    def trailer_steer_limit(self) -> float | None:
        """Limit of the last trailer's actuators [rad]; None: none is steered."""
        return self.trailers[-1].max_steer

    @property
    def trailers_ahead(self) -> tuple[JudgedTrailer, ...]:
        """Judged trailers ahead of the last, front to rear."""
        return self.trailers[:-1]

    def poses(self, unit: UnitOutline) -> FloatArray:
        """Pose of the unit's frame over time: x [m], y [m], psi [rad], shape (n_rows, 3)."""
        return np.column_stack([self.log[f"{quantity}_{unit.name}"] for quantity in ("x", "y", "psi")])

    def signal(self, name: str) -> FloatArray:
        """The signal over time, shape (n_rows,); NaN throughout if this run has none of that name."""
        return self.log[name] if name in self.log else np.full(len(self.log), np.nan)

    def steer_signals(self, trailer: str = "", *, demands: bool = False) -> tuple[str, ...]:
        """Names of the signals of a trailer's steer angles or demands, front to rear; by default the last's."""
        judged = next((one for one in self.trailers if one.name == trailer), self.trailers[-1])
        ending = f"command_{judged.name}" if demands else judged.name
        return tuple(f"steer_trailer_{k}_{ending}" for k in range(1, judged.n_steered + 1))

    def axle_steer(self, unit: UnitOutline) -> FloatArray:
        """Steer angle of each axle of a unit over time, shape (n_rows, n_axles) [rad], for drawings."""
        zero = np.zeros(len(self.log))
        angles = [self.signal(name) if name else zero for name in unit.steer_signals]
        return np.nan_to_num(np.column_stack(angles)) if angles else np.zeros((len(self.log), 0))


def error_of_estimate(result: RunResult, trailer: str = "") -> FloatArray:
    """Estimated minus true off-tracking at the time of capture [m], (n_rows,), NaN elsewhere; by default the last's."""
    name = trailer or result.trailers[-1].name
    estimate, true, health = (
        result.signal(f"{quantity}_{name}") for quantity in ("off_tracking_estimate", "off_tracking_true", "health")
    )
    return metrics.estimate_error(estimate, true, health)
