"""Where the way of a path state has led the wheels: the line of the trace, and the front wheel's rut beside it."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker.path_state import HEADING, OFFSET, PIECES, SAND, SHADE, SLIP, PathState
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_BEND: Final = 2  # pieces on either side over which a yaw rate is taken


class _Way(NamedTuple):
    """How the body went and stood at the pieces' ends, newest first, against how it stands now."""

    directions: FloatArray  # (PIECES,) of the middle's travel on each piece [rad]
    turned: FloatArray  # (PIECES + 1,) [rad]
    back: FloatArray  # (PIECES + 1,) where the middle was [m]
    aside: FloatArray  # (PIECES + 1,) [m]

    def passed(self, origin: float, place: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Ways back from x = ``origin`` and aside of y of a place on the body, at the pieces' ends [m]."""
        x, y = place
        cos, sin = np.cos(self.turned), np.sin(self.turned)
        return self.back + origin - x * cos + y * sin, self.aside + x * sin + y * (cos - 1.0)


def slip_at(state: PathState, piece: int) -> tuple[float, float]:
    """Slip of the middle, without steering, at the newer end of a piece, and its variance [rad, rad^2]."""
    ends = [max(piece - 1, 0), piece]  # a piece's slip is that of its middle
    return float(state.mean[ends].mean()), float(state.covariance[np.ix_(ends, ends)].mean())


def bend(state: PathState, piece: int) -> float:
    """Yaw over the way about the newer end of a piece [rad/m]."""
    newest, oldest = max(piece - _BEND, 0), min(piece + _BEND, PIECES - 1)
    return float((state.headings[newest] - state.headings[oldest]) / state.lengths[newest:oldest].sum())


def trace(state: PathState, rig: TraceRig, behind: FloatArray) -> FloatArray:
    """Where beside the wheel the trace lies (n,) at places behind it (n,) [m]."""
    back, aside = _way(state).passed(rig.wheel[0], rig.wheel)
    lies: FloatArray = np.interp(behind, back, aside) + state.offset
    return lies


def seen(state: PathState, rig: TraceRig, bands: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the bands (n,) of a picture show the trace (n,) [m], and the gradient (n, len(mean)) of that."""
    way = _way(state)
    back, aside = way.passed(rig.wheel[0], rig.wheel)
    piece = np.clip(np.searchsorted(back, bands) - 1, 0, PIECES - 1)
    share = (bands - back[piece]) / (back[piece + 1] - back[piece])
    weights = (np.arange(PIECES) < piece[:, None]) + (np.arange(PIECES) == piece[:, None]) * share[:, None]
    by_direction = -state.lengths * np.cos(way.directions) * weights
    by_turn = np.zeros((len(bands), PIECES + 1))  # of the body at the pieces' ends
    by_turn[:, :-1] += 0.5 * by_direction
    by_turn[:, 1:] += 0.5 * by_direction
    lever, band = rig.wheel[0] * np.cos(way.turned), np.arange(len(bands))
    by_turn[band, piece] += (1.0 - share) * lever[piece]
    by_turn[band, piece + 1] += share * lever[piece + 1]
    by_turn[:, 0] -= by_turn.sum(axis=1)  # all turns are against the body as it stands now
    by_turn[:, -2] += by_turn[:, -1]  # the last piece's older end is believed to point as its newer one
    gradient = np.zeros((len(bands), len(state.mean)))
    gradient[:, SLIP], gradient[:, HEADING] = by_direction, by_turn[:, :-1]
    gradient[band, SAND.start + piece] = 1.0
    gradient[band, SHADE.start + band] = 1.0
    gradient[:, OFFSET] = 1.0
    line = aside[piece] + share * (aside[piece + 1] - aside[piece]) + state.offset
    return line + state.mean[SAND][piece] + state.mean[SHADE], gradient


def with_fronts(state: PathState, rig: TraceRig) -> PathState:
    """With where the front wheel's rut lies beside each piece, as the slip that would put it there straight on.

    The front wheel came by a wheelbase earlier; its rut lies beside the rear one by what the rover slipped and turned
    since. Two ruts beside each other look much different from one: this is what templates go by. Pieces whose front
    wheel passed longer ago than the state goes back keep what was known of them.
    """
    way = _way(state)
    back, aside = way.passed(rig.wheel[0], rig.wheel)
    front_back, front_aside = way.passed(rig.wheel[0], (rig.wheel[0] + rig.wheelbase, rig.wheel[1]))
    known = back[:-1] <= front_back[-1]
    beside = aside[:-1] - np.interp(back[:-1], front_back, front_aside)
    slips = np.arctan2(beside * np.cos(way.directions), rig.wheelbase)
    return state._replace(fronts=np.where(known, slips, state.fronts))


def fronts_at(state: PathState, rig: TraceRig, behind: FloatArray) -> FloatArray:
    """Slip (n,) that would put the front wheel's rut where it lies at places behind the rear wheel [rad]."""
    back, _ = _way(state).passed(rig.wheel[0], rig.wheel)
    piece: NDArray[np.intp] = np.clip(np.searchsorted(back, behind) - 1, 0, PIECES - 1)
    fronts: FloatArray = np.where(np.isnan(state.fronts), state.body_slips, state.fronts)[piece]
    return fronts


def _way(state: PathState) -> _Way:
    """Where the rover was before it stood as it does now."""
    turned = np.empty(PIECES + 1)
    turned[:-1], turned[-1] = state.headings, state.headings[-1]
    turned -= turned[0]
    directions = state.body_slips + 0.5 * (turned[:-1] + turned[1:])
    back, aside = np.zeros(PIECES + 1), np.zeros(PIECES + 1)
    np.cumsum(state.lengths * np.cos(directions), out=back[1:])
    np.cumsum(-state.lengths * np.sin(directions), out=aside[1:])
    return _Way(directions, turned, back, aside)
