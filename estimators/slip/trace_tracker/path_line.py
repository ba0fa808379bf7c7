"""Geometry of a path state: the line of the trace, and the lateral offset of the front wheel's rut."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker.path_state import HEADING, OFFSET, PIECES, SAND, SHADE, SLIP, PathState
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

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
