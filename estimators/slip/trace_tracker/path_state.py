"""Path state: a Kalman filter of the slip history, the line of the trace, and a mixture of such filters.

The path consists of pieces, the newest first. State: slip angle of the rover's centre on each piece, relative to the
steered direction; heading on each piece; lateral error of the rut in the sand on each piece; lateral error of each band
of the image, from shadows that move with the rover; lateral offset of the whole trace (sinkage, roll and mounting);
error of the encoders' yaw rate; trend of slip. The position of the trace is linear in all of these up to the cosine of
small angles, so the filter is linear. Past pieces stay in the state, which makes it a smoother for them.

Slip is that of the centre, as it changes slowly: rear wheels move sideways with every turn of the rover, which encoders
and compass measure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray


class _Pace(NamedTuple):
    """Random walk of slip, plus a trend with a correlation length."""

    walk: float  # per sqrt(m) [rad]
    trend: float  # standard deviation [rad/m]
    length: float  # correlation length of the trend [m]


# Slip that varies by 1.6 deg within 5 s at 8 cm/s has a random walk of 3.6 deg/sqrt(m).
QUICK: Final = _Pace(walk=math.radians(4.0), trend=0.0, length=1.0)
# A rover that drives onto a slope (Reina 2008, Fig. 8): some degrees within some decimetres.
_STEADY: Final = _Pace(walk=math.radians(1.0), trend=math.radians(3.0), length=1.0)
PACES: Final = (QUICK, _STEADY)
PIECES: Final = 56  # each at least SHORTEST long; together the visible length of the trace
SHORTEST: Final = 0.0125  # [m]
SLIP, HEADING, SAND = (slice(k * PIECES, (k + 1) * PIECES) for k in range(3))  # places in the state
SHADE: Final = slice(3 * PIECES, -3)
OFFSET, RATE, TREND = -3, -2, -1
_SLIP_PRIOR: Final = math.radians(6.0)  # before any observation: loose sand on moderate slopes, assumed
_SLIP_CORRELATION: Final = 0.4  # correlation length of slip on a new trace [m]
_OFFSET_PRIOR: Final = 0.005  # error of sinkage, templates and calibration [m]
_OFFSET_WALK: Final = 0.002  # per sqrt(m): template errors of millimetres, different for each slip and sun [m]
_SAND_STD: Final = 0.002  # lateral error of a rut by crumbs and slumping [m]
_SAND_LENGTH: Final = 0.04  # correlation length of that error: a band of the image [m]
# The edge of a shadow that moves with the rover stays in the same bands and shifts them by some millimetres.
_SHADE_STD: Final = 0.003  # [m]
_SHADE_LENGTH: Final = 3.0  # correlation length of that shift, by the rover's turns against the sun, assumed [m]
_RATE_PRIOR: Final = math.radians(0.6)  # error of the encoders' yaw rate by scrubbing and slip, assumed [rad/s]
_RATE_TIME: Final = 2.0  # correlation time of that error, assumed [s]
_COMPASS: Final = math.radians(0.4)  # RMS of one reading of a fluxgate compass without its constant error [rad]


class PathState(NamedTuple):
    """Mean and covariance of the state, and the known quantities."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)
    lengths: FloatArray  # (PIECES,) of the pieces, newest first [m]
    steer: FloatArray  # (PIECES,) steered direction on each piece, relative to the body [rad]
    ticks: FloatArray  # (PIECES,) of each piece's newer end
    fronts: FloatArray  # (PIECES,) see ``path_state.with_fronts``; NaN: not known yet [rad]
    steered: float  # current steered direction [rad]
    pace: _Pace

    @property
    def offset(self) -> float:
        """Lateral offset of the trace from the wheel, + left [m]."""
        return float(self.mean[OFFSET])

    @property
    def headings(self) -> FloatArray:
        """Headings (PIECES,) of the rover at the newer end of each piece, unwrapped [rad]."""
        return self.mean[HEADING]

    @property
    def body_slips(self) -> FloatArray:
        """Slip angles (PIECES,) of the centre on each piece, relative to the body at that time [rad]."""
        return self.mean[SLIP] + self.steer


def begun(heading: float, steer: float, tick: int, bands: int, pace: _Pace) -> PathState:
    """State before any observation: the rover came from about straight behind."""
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
    # straight on in the past, with an uncertainty of 1 deg per decimetre
    headings = math.radians(1.0) ** 2 * np.minimum(at[:, None], at) * ds / 0.1
    state.covariance[HEADING, HEADING] = headings + _COMPASS**2
    state.covariance[SAND, SAND] = _SAND_STD**2 * _correlation(state.lengths, _SAND_LENGTH)
    state.covariance[SHADE, SHADE] = _SHADE_STD**2 * np.eye(bands)
    state.covariance[RATE, RATE] = _RATE_PRIOR**2
    return with_slip(state, 0.0, _SLIP_PRIOR)


def with_slip(state: PathState, slip: float, std: float) -> PathState:
    """State with the slip of a new trace; earlier slip and offset are dropped."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    for part in (SLIP, OFFSET, TREND):
        mean[part] = 0.0
        covariance[part] = 0.0
        covariance[:, part] = 0.0
    mean[SLIP] = slip
    covariance[SLIP, SLIP] = std**2 * _correlation(state.lengths, _SLIP_CORRELATION)
    covariance[OFFSET, OFFSET] = _OFFSET_PRIOR**2
    covariance[TREND, TREND] = state.pace.trend**2
    return state._replace(mean=mean, covariance=covariance, fronts=np.full(PIECES, math.nan))


def moved(state: PathState, length: float, yaw: float, seconds: float, steer: float, tick: int) -> PathState:
    """State after one more piece, without the oldest; ``yaw`` is the turn by the encoders [rad]."""
    pieces = np.maximum(np.arange(PIECES) - 1, 0)
    order = np.arange(len(state.mean))
    for part in (SLIP, HEADING, SAND):
        order[part] = part.start + pieces
    mean, covariance = state.mean[order], state.covariance[order][:, order]
    pace, bands = state.pace, len(mean) - 3 * PIECES - 3
    mean[HEADING.start] += yaw
    _add(mean, covariance, HEADING.start, RATE, seconds)
    _add(mean, covariance, SLIP.start, TREND, length)
    covariance[0, 0] += pace.walk**2 * length
    covariance[OFFSET, OFFSET] += _OFFSET_WALK**2 * length
    _fade(mean, covariance, np.array([RATE]), seconds / _RATE_TIME, np.array([_RATE_PRIOR**2]))
    _fade(mean, covariance, np.array([TREND]), length / pace.length, np.array([pace.trend**2]))
    _fade(mean, covariance, np.array([SAND.start]), length / _SAND_LENGTH, np.array([_SAND_STD**2]))
    _fade(mean, covariance, np.arange(bands) + SHADE.start, length / _SHADE_LENGTH, np.full(bands, _SHADE_STD**2))
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
    """State with the heading corrected by a compass reading [rad]."""
    column = state.covariance[HEADING.start]  # the heading itself is measured
    variance = column[HEADING.start] + _COMPASS**2
    innovation = math.remainder(reading - float(state.headings[0]), 2.0 * math.pi)
    gained = column / math.sqrt(variance)
    return state._replace(
        mean=state.mean + (innovation / variance) * column, covariance=state.covariance - np.outer(gained, gained)
    )


def with_innovation(
    state: PathState, gradient: FloatArray, innovation: FloatArray, noise: FloatArray
) -> tuple[PathState, float]:
    """State corrected by an innovation (n,), and its log likelihood."""
    projected = gradient @ state.covariance
    root = np.linalg.cholesky(projected @ gradient.T + noise)
    # with the Cholesky factor the covariance stays exactly symmetric
    solved = np.linalg.solve(root, np.column_stack([projected, innovation]))
    gained, surprise = solved[:, :-1], solved[:, -1]
    covariance = state.covariance - gained.T @ gained
    size = 2.0 * np.log(root.diagonal()).sum() + len(innovation) * math.log(2.0 * math.pi)
    likelihood = -0.5 * float(surprise @ surprise + size)
    return state._replace(mean=state.mean + surprise @ gained, covariance=covariance), likelihood


def _pushed(values: FloatArray, newest: float) -> FloatArray:
    """Values with the newest in front, without the oldest."""
    pushed = np.empty_like(values)
    pushed[0], pushed[1:] = newest, values[:-1]
    return pushed


def _correlation(lengths: FloatArray, correlation_length: float) -> FloatArray:
    """Correlation matrix of pieces, decaying exponentially over ``correlation_length`` [m]."""
    at = np.cumsum(lengths)
    correlations: FloatArray = np.exp(-np.abs(at[:, None] - at) / correlation_length)
    return correlations


def _add(mean: FloatArray, covariance: FloatArray, part: int, of: int, factor: float) -> None:
    """Add a multiple of one component of the state to another, in place."""
    mean[part] += factor * mean[of]
    covariance[part] += factor * covariance[of]
    covariance[:, part] += factor * covariance[:, of]


def _fade(
    mean: FloatArray, covariance: FloatArray, parts: NDArray[np.intp], lengths: float, variances: FloatArray
) -> None:
    """Decay components (n,) of the state over ``lengths`` correlation lengths, with their stationary variances."""
    keep = math.exp(-lengths)
    mean[parts] *= keep
    covariance[parts] *= keep
    covariance[:, parts] *= keep
    covariance[parts, parts] += (1.0 - keep**2) * variances


_BEND: Final = 2  # pieces on either side for the curvature


class _PastPoses(NamedTuple):
    """Poses of the body at the pieces' ends, newest first, in the current body frame."""

    directions: FloatArray  # (PIECES,) of the centre's travel on each piece [rad]
    turned: FloatArray  # (PIECES + 1,) yaw [rad]
    back: FloatArray  # (PIECES + 1,) distance of the centre backwards [m]
    lateral: FloatArray  # (PIECES + 1,) of the centre, + left [m]

    def passed(self, origin: float, place: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Path of a point on the body: distances backwards from x = ``origin`` and lateral offsets [m]."""
        x, y = place
        cos, sin = np.cos(self.turned), np.sin(self.turned)
        return self.back + origin - x * cos + y * sin, self.lateral + x * sin + y * (cos - 1.0)


def slip_at(state: PathState, piece: int) -> tuple[float, float]:
    """Slip of the centre, without steering, at the newer end of a piece, and its variance [rad, rad2]."""
    ends = [max(piece - 1, 0), piece]  # the slip of a piece belongs to its centre
    return float(state.mean[ends].mean()), float(state.covariance[np.ix_(ends, ends)].mean())


def bend(state: PathState, piece: int) -> float:
    """Yaw change per distance at the newer end of a piece [rad/m]."""
    newest, oldest = max(piece - _BEND, 0), min(piece + _BEND, PIECES - 1)
    return float((state.headings[newest] - state.headings[oldest]) / state.lengths[newest:oldest].sum())


def trace(state: PathState, rig: TraceRig, behind: FloatArray) -> FloatArray:
    """Lateral position (n,) of the trace at distances (n,) behind the wheel [m]."""
    back, lateral = _past_poses(state).passed(rig.wheel[0], rig.wheel)
    lies: FloatArray = np.interp(behind, back, lateral) + state.offset
    return lies


def predicted(state: PathState, rig: TraceRig, bands: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Predicted lateral position (n,) of the trace in the bands (n,) [m], and its gradient (n, len(mean))."""
    past = _past_poses(state)
    back, lateral = past.passed(rig.wheel[0], rig.wheel)
    piece = np.clip(np.searchsorted(back, bands) - 1, 0, PIECES - 1)
    share = (bands - back[piece]) / (back[piece + 1] - back[piece])
    weights = (np.arange(PIECES) < piece[:, None]) + (np.arange(PIECES) == piece[:, None]) * share[:, None]
    by_direction = -state.lengths * np.cos(past.directions) * weights
    by_turn = np.zeros((len(bands), PIECES + 1))  # by the yaw at the pieces' ends
    by_turn[:, :-1] += 0.5 * by_direction
    by_turn[:, 1:] += 0.5 * by_direction
    lever, band = rig.wheel[0] * np.cos(past.turned), np.arange(len(bands))
    by_turn[band, piece] += (1.0 - share) * lever[piece]
    by_turn[band, piece + 1] += share * lever[piece + 1]
    by_turn[:, 0] -= by_turn.sum(axis=1)  # yaw is relative to the current body
    by_turn[:, -2] += by_turn[:, -1]  # the last piece's older end has the heading of its newer one
    gradient = np.zeros((len(bands), len(state.mean)))
    gradient[:, SLIP], gradient[:, HEADING] = by_direction, by_turn[:, :-1]
    gradient[band, SAND.start + piece] = 1.0
    gradient[band, SHADE.start + band] = 1.0
    gradient[:, OFFSET] = 1.0
    line = lateral[piece] + share * (lateral[piece + 1] - lateral[piece]) + state.offset
    return line + state.mean[SAND][piece] + state.mean[SHADE], gradient


def with_fronts(state: PathState, rig: TraceRig) -> PathState:
    """State with the front wheel's rut beside each piece, as the slip angle with the same offset in straight travel.

    The front wheel passed one wheelbase earlier. Its rut is offset from the rear one by the slip and turn since then.
    Two ruts side by side look different from one, so templates are indexed by this angle. Pieces that the front wheel
    passed before the start of the state keep their last value.
    """
    past = _past_poses(state)
    back, lateral = past.passed(rig.wheel[0], rig.wheel)
    front_back, front_lateral = past.passed(rig.wheel[0], (rig.wheel[0] + rig.wheelbase, rig.wheel[1]))
    known = back[:-1] <= front_back[-1]
    offset = lateral[:-1] - np.interp(back[:-1], front_back, front_lateral)
    slips = np.arctan2(offset * np.cos(past.directions), rig.wheelbase)
    return state._replace(fronts=np.where(known, slips, state.fronts))


def fronts_at(state: PathState, rig: TraceRig, behind: FloatArray) -> FloatArray:
    """Slip angles (n,) of ``with_fronts`` at distances behind the rear wheel [rad]."""
    back, _ = _past_poses(state).passed(rig.wheel[0], rig.wheel)
    piece: NDArray[np.intp] = np.clip(np.searchsorted(back, behind) - 1, 0, PIECES - 1)
    fronts: FloatArray = np.where(np.isnan(state.fronts), state.body_slips, state.fronts)[piece]
    return fronts


def _past_poses(state: PathState) -> _PastPoses:
    """Past poses in the current body frame."""
    turned = np.empty(PIECES + 1)
    turned[:-1], turned[-1] = state.headings, state.headings[-1]
    turned -= turned[0]
    directions = state.body_slips + 0.5 * (turned[:-1] + turned[1:])
    back, lateral = np.zeros(PIECES + 1), np.zeros(PIECES + 1)
    np.cumsum(state.lengths * np.cos(directions), out=back[1:])
    np.cumsum(-state.lengths * np.sin(directions), out=lateral[1:])
    return _PastPoses(directions, turned, back, lateral)


_FORGETTING: Final = 0.99  # per image: slip that was steady for twenty seconds may change
_LEAST: Final = -5.0  # least log weight of a pace relative to the best, so that it can recover


class Histories(NamedTuple):
    """One path state for each pace, with their weights."""

    paths: tuple[PathState, ...]
    worth: FloatArray  # (paces,) log weights up to a constant

    @property
    def shares(self) -> FloatArray:
        """Normalised weights (paces,)."""
        share = np.exp(self.worth - self.worth.max())
        total: FloatArray = share / share.sum()
        return total

    @property
    def together(self) -> PathState:
        """Mixture of the paces: mean, and covariance including their differences."""
        shares = self.shares
        means = np.stack([path.mean for path in self.paths])
        mean = shares @ means
        off = np.sqrt(shares)[:, None] * (means - mean)
        covariance = off.T @ off
        for share, path in zip(shares, self.paths, strict=True):
            covariance += share * path.covariance
        return self.paths[0]._replace(mean=mean, covariance=covariance)

    def each(self, changed: Callable[[PathState], PathState]) -> Histories:
        """Histories with every path changed."""
        return self._replace(paths=tuple(changed(path) for path in self.paths))


def begun_histories(heading: float, steer: float, tick: int, bands: int) -> Histories:
    """Histories before any observation."""
    paths = tuple(begun(heading, steer, tick, bands, pace) for pace in PACES)
    return Histories(paths, np.zeros(len(paths)))


def with_new_trace(histories: Histories, slip: float, std: float) -> Histories:
    """Histories with the slip of a new trace [rad] and equal weights."""
    return histories.each(lambda path: with_slip(path, slip, std))._replace(worth=np.zeros(len(PACES)))


def with_trace(
    histories: Histories,
    predictions: Sequence[tuple[FloatArray, FloatArray]],
    positions: FloatArray,
    use: NDArray[np.bool_],
    noise: FloatArray,
) -> Histories:
    """Histories corrected by lateral positions (bands,) of the trace, in the bands of ``use``, after ``predicted``."""
    paths, worth = [], []
    for path, (expected, gradient) in zip(histories.paths, predictions, strict=True):
        corrected, likelihood = with_innovation(path, gradient[use], (positions - expected)[use], noise)
        paths.append(corrected)
        worth.append(likelihood)
    kept = _FORGETTING * histories.worth + np.array(worth)
    return Histories(tuple(paths), np.maximum(kept - kept.max(), _LEAST))
