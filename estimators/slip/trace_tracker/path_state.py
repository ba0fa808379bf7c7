"""The trace as a history of slip: a Kalman filter over the way that the rover went since it passed what is seen.

The way consists of pieces, the newest first. State: slip on each piece, by which the rover's middle goes aside of
where its wheels are steered to; the rover's heading on each piece; by how much the sand shows the rut aside of where
it is, on each piece; by how much each band of the picture does, as shadows that move with the rover have it; lateral
offset of the whole trace (sinkage, roll and mounting move it); error of the encoders' yaw rate; the trend of slip.
Where the trace lies is linear in all of these up to the cosine of small angles, so the filter is; keeping the pieces
of the past in the state makes it a smoother for them.

Slip is that of the middle, as this is what changes slowly: wheels at the rear go aside with every turn of the rover,
which encoders and compass tell of.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from estimators.slip.trace_tracker.pace import Pace
from estimators.slip.trace_tracker.walks import add, alike, fade
from vehicle.frames import FloatArray

PIECES: Final = 56  # each at least SHORTEST long: what a camera sees of the trace
SHORTEST: Final = 0.0125  # [m]
SLIP, HEADING, SAND = (slice(k * PIECES, (k + 1) * PIECES) for k in range(3))  # places in the state
SHADE: Final = slice(3 * PIECES, -3)
OFFSET, RATE, TREND = -3, -2, -1

_SLIP_PRIOR: Final = math.radians(6.0)  # of a rover of which nothing was seen: loose sand on moderate slopes, assumed
_SLIP_CORRELATION: Final = 0.4  # way over which slip on a trace just found is alike [m]
_OFFSET_PRIOR: Final = 0.005  # what sinkage, templates and calibration are off by [m]
_OFFSET_WALK: Final = 0.002  # per sqrt(m): templates are off by millimetres, differently for each slip and sun [m]
_SAND_STD: Final = 0.002  # by which crumbs and slumping put a rut aside, and [m]
_SAND_WAY: Final = 0.04  # over which they do so: a band of the picture [m]
# An edge of a shadow that moves with the rover lies in the same bands for long and puts them aside by 5 to 10 mm; where
# none is, every band tells soon enough that it is right.
_SHADE_STD: Final = 0.004  # [m]
_SHADE_WAY: Final = 3.0  # over which shadows move, by the rover's turns against the sun, assumed [m]
_RATE_PRIOR: Final = math.radians(0.6)  # error of the encoders' yaw rate: wheels scrub and slip, assumed [rad/s]
_RATE_TIME: Final = 2.0  # over which that error changes, assumed [s]
_COMPASS: Final = math.radians(0.4)  # RMS of one reading of a fluxgate compass without what is steady [rad]


class PathState(NamedTuple):
    """Mean and covariance of the state, and what is known for sure."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)
    lengths: FloatArray  # (PIECES,) of the pieces, newest first [m]
    steer: FloatArray  # (PIECES,) direction that the wheels are steered to on each piece, against the body [rad]
    ticks: FloatArray  # (PIECES,) at each piece's newer end
    fronts: FloatArray  # (PIECES,) see ``path_line.with_fronts``; NaN: unknown yet [rad]
    steered: float  # that direction now [rad]
    pace: Pace

    @property
    def offset(self) -> float:
        """Of the trace beside the wheel, + left [m]."""
        return float(self.mean[OFFSET])

    @property
    def headings(self) -> FloatArray:
        """Of the rover at the newer end of each piece, continuous (PIECES,) [rad]."""
        return self.mean[HEADING]

    @property
    def body_slips(self) -> FloatArray:
        """Of the middle's travel on each piece, against the body as it stood then (PIECES,) [rad]."""
        return self.mean[SLIP] + self.steer


def begun(heading: float, steer: float, tick: int, bands: int, pace: Pace) -> PathState:
    """Before anything was seen: the rover may have come from anywhere near straight behind."""
    ds = 0.016  # assumed until the wheels turn [m]
    size = 3 * PIECES + bands + 3
    state = PathState(
        mean=np.zeros(size),
        covariance=np.zeros((size, size)),
        lengths=np.full(PIECES, ds),
        steer=np.full(PIECES, steer),
        ticks=np.full(PIECES, float(tick)),
        fronts=np.full(PIECES, math.nan),
        steered=steer,
        pace=pace,
    )
    state.mean[HEADING] = heading
    at = np.arange(PIECES)
    # Straight on in the past, give or take a degree a decimetre.
    headings = math.radians(1.0) ** 2 * np.minimum(at[:, None], at) * ds / 0.1
    state.covariance[HEADING, HEADING] = headings + _COMPASS**2
    state.covariance[SAND, SAND] = _SAND_STD**2 * alike(state.lengths, _SAND_WAY)
    state.covariance[SHADE, SHADE] = _SHADE_STD**2 * np.eye(bands)
    state.covariance[RATE, RATE] = _RATE_PRIOR**2
    return with_slip(state, 0.0, _SLIP_PRIOR)


def with_slip(state: PathState, slip: float, std: float) -> PathState:
    """The same, with the slip of a trace just found; what was believed of slip and offset is forgotten."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    for part in (SLIP, OFFSET, TREND):
        mean[part] = 0.0
        covariance[part] = 0.0
        covariance[:, part] = 0.0
    mean[SLIP] = slip
    covariance[SLIP, SLIP] = std**2 * alike(state.lengths, _SLIP_CORRELATION)
    covariance[OFFSET, OFFSET] = _OFFSET_PRIOR**2
    covariance[TREND, TREND] = state.pace.trend**2
    return state._replace(mean=mean, covariance=covariance, fronts=np.full(PIECES, math.nan))


def moved(state: PathState, length: float, yaw: float, seconds: float, steer: float, tick: int) -> PathState:
    """One piece on, the oldest forgotten; ``yaw`` is what the encoders say that the rover turned [rad]."""
    pieces = np.maximum(np.arange(PIECES) - 1, 0)
    order = np.arange(len(state.mean))
    for part in (SLIP, HEADING, SAND):
        order[part] = part.start + pieces
    mean, covariance = state.mean[order], state.covariance[order][:, order]
    pace, bands = state.pace, len(mean) - 3 * PIECES - 3
    mean[HEADING.start] += yaw
    add(mean, covariance, HEADING.start, RATE, seconds)
    add(mean, covariance, SLIP.start, TREND, length)
    covariance[0, 0] += pace.walk**2 * length
    covariance[OFFSET, OFFSET] += _OFFSET_WALK**2 * length
    fade(mean, covariance, np.array([RATE]), seconds / _RATE_TIME, np.array([_RATE_PRIOR**2]))
    fade(mean, covariance, np.array([TREND]), length / pace.way, np.array([pace.trend**2]))
    fade(mean, covariance, np.array([SAND.start]), length / _SAND_WAY, np.array([_SAND_STD**2]))
    fade(mean, covariance, np.arange(bands) + SHADE.start, length / _SHADE_WAY, np.full(bands, _SHADE_STD**2))
    return state._replace(
        mean=mean,
        covariance=covariance,
        lengths=_pushed(state.lengths, length),
        steer=_pushed(state.steer, 0.5 * (steer + state.steered)),
        ticks=_pushed(state.ticks, tick),
        fronts=_pushed(state.fronts, math.nan),
        steered=steer,
    )


def with_compass(state: PathState, reading: float) -> PathState:
    """The heading corrected by a compass reading [rad]."""
    told = state.covariance[HEADING.start]  # a single part of the state is measured as it is
    variance = told[HEADING.start] + _COMPASS**2
    innovation = math.remainder(reading - float(state.headings[0]), 2.0 * math.pi)
    gained = told / math.sqrt(variance)
    return state._replace(
        mean=state.mean + (innovation / variance) * told, covariance=state.covariance - np.outer(gained, gained)
    )


def with_seen(
    state: PathState, gradient: FloatArray, innovation: FloatArray, noise: FloatArray
) -> tuple[PathState, float]:
    """Corrected by what was seen beside what was expected (n,), and the log likelihood of that."""
    projected = gradient @ state.covariance
    root = np.linalg.cholesky(projected @ gradient.T + noise)
    # With roots the covariance stays symmetric to the last bit.
    told = np.linalg.solve(root, np.column_stack([projected, innovation]))
    gained, surprise = told[:, :-1], told[:, -1]
    covariance = state.covariance - gained.T @ gained
    size = 2.0 * np.log(root.diagonal()).sum() + len(innovation) * math.log(2.0 * math.pi)
    likelihood = -0.5 * float(surprise @ surprise + size)
    return state._replace(mean=state.mean + surprise @ gained, covariance=covariance), likelihood


def _pushed(values: FloatArray, newest: float) -> FloatArray:
    """The newest before the others, the oldest forgotten."""
    pushed = np.empty_like(values)
    pushed[0], pushed[1:] = newest, values[:-1]
    return pushed
