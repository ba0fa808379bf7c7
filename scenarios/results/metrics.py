"""Metrics of a run as pure functions of arrays: off-tracking, its estimate, steering and odometry.

Arrays run along time. NaN means "no value" and is ignored.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenarios.results.log import LOST
from vehicle.frames import FloatArray

_SIGMAS = 2.5  # standard deviations that 95 of 100 errors should not exceed, even if they are not quite normal
_AT_REST = 1e-7  # a smaller step back between two samples is the integrator's rounding [m]


def true_off_tracking(x: FloatArray, y: FloatArray, psi: FloatArray, follow_distance: float) -> FloatArray:
    """Off-tracking e [m], shape (n,): lateral distance from follow point to hitch path in the trailer's frame.

    Args:
        x: path of the hitch, the origin of the trailer's frame [m], shape (n,), samples equally spaced in time.
        y: likewise.
        psi: yaw of the same trailer [rad].
        follow_distance: hitch to follow point [m], positive.

    Positive when the path lies left of the follow point. The line through the follow point is square to the trailer.
    Going back in time from each sample, the path's first crossing of this line counts, so a path may cross itself.
    NaN where the path does not reach back that far.

    The path is the track of the hitch as it travels forwards. Reversing shortens it: a path point is removed as soon as
    the hitch is behind the line that lay across the trailer at that point. The path then continues from the hitch.

    The search strides like a ray march: after a path point at distance d ahead of the line, no crossing can follow
    within the next d metres of path. Between samples the path is a Catmull-Rom cubic. A chord would be ds^2/(8 R) off:
    0.02 mm at walking pace and ten times that at 45 km/h.
    """
    if follow_distance <= 0.0:
        raise ValueError(f"follow_distance = {follow_distance} m must be positive")
    off_tracking = np.full(len(x), np.nan)
    if len(x) < 2:
        return off_tracking
    track, heading = x + 1j * y, np.exp(-1j * psi)
    for samples, first in _paths(track, heading):
        path = track[samples]
        older, crossed = _crossing(path, heading[samples], follow_distance, first)
        padded = np.concatenate([[2 * path[0] - path[1]], path, [2 * path[-1] - path[-2]]])  # straight on at both ends
        corners = padded[older[:, None] + np.arange(4)]  # samples older-1 ... older+2
        corners_S = (corners - path[crossed, None]) * heading[samples[crossed], None]
        off_tracking[samples[crossed]] = _lateral_at(corners_S, -follow_distance)
    return off_tracking


def _paths(track: NDArray[np.complex128], heading: NDArray[np.complex128]) -> Iterator[tuple[NDArray[np.intp], int]]:
    """Sample indices of every path in turn, oldest first, and the position of the first new sample in it.

    A path grows until the hitch reverses; each sample of the reversing begins a new path.
    """
    back = (np.diff(track) * heading[:-1]).real < -_AT_REST
    samples = np.empty(0, dtype=np.intp)
    for begin, end in pairwise([0, *(np.flatnonzero(back) + 1).tolist(), len(track)]):
        kept = len(samples)
        while kept and ((track[begin] - track[samples[kept - 1]]) * heading[samples[kept - 1]]).real < 0.0:
            kept -= 1
        samples = np.concatenate([samples[:kept], np.arange(begin, end)])
        if len(samples) > 1:
            yield samples, kept


def _crossing(
    path: NDArray[np.complex128], heading: NDArray[np.complex128], follow_distance: float, first: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Last index at or behind the follow point's line for samples from ``first`` on; and the samples that have one."""
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path)))])
    new = np.arange(first, len(path))
    candidate = np.full(len(path), -1)
    candidate[new] = np.searchsorted(travelled, travelled[new] - follow_distance, side="right") - 1
    searching = np.flatnonzero(candidate >= 0)
    crossed: list[NDArray[np.intp]] = []
    while searching.size:
        at = candidate[searching]
        ahead = ((path[at] - path[searching]) * heading[searching]).real + follow_distance
        crossed.append(searching[ahead <= 0.0])
        searching, at, ahead = searching[ahead > 0.0], at[ahead > 0.0], ahead[ahead > 0.0]
        stride = np.searchsorted(travelled, travelled[at] - ahead, side="right") - 1
        candidate[searching] = np.minimum(stride, at - 1)
        searching = searching[candidate[searching] >= 0]
    samples = np.sort(np.concatenate(crossed)) if crossed else np.empty(0, dtype=np.intp)
    return candidate[samples], samples


def _lateral_at(p: NDArray[np.complex128], x: float) -> FloatArray:
    """Lateral coordinate where Catmull-Rom cubics through p[:, 1] and p[:, 2], shape (n, 4), have longitudinal x."""
    a = 0.5 * (-p[:, 0] + 3.0 * p[:, 1] - 3.0 * p[:, 2] + p[:, 3])
    b = 0.5 * (2.0 * p[:, 0] - 5.0 * p[:, 1] + 4.0 * p[:, 2] - p[:, 3])
    c = 0.5 * (p[:, 2] - p[:, 0])
    t = (x - p[:, 1].real) / (p[:, 2] - p[:, 1]).real
    for _ in range(4):  # Newton from the chord's answer; curvature within one sample is tiny
        slope = ((3.0 * a * t + 2.0 * b) * t + c).real
        residual = (((a * t + b) * t + c) * t + p[:, 1]).real - x
        t = np.clip(t - residual / np.where(slope == 0.0, np.inf, slope), 0.0, 1.0)
    lateral: FloatArray = (((a * t + b) * t + c) * t + p[:, 1]).imag
    return lateral


def rms(values: FloatArray) -> float:
    """Root mean square of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def peak(values: FloatArray) -> float:
    """Largest magnitude of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.max(np.abs(finite))) if finite.size else float("nan")


def time_of_peak(values: FloatArray, time: FloatArray) -> float:
    """Time [s] of the largest magnitude of the finite values; NaN if there are none."""
    return float(time[np.nanargmax(np.abs(values))]) if np.isfinite(values).any() else float("nan")


def mean(values: FloatArray) -> float:
    """Mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else float("nan")


def estimate_error(estimate: FloatArray, truth: FloatArray, health: FloatArray) -> FloatArray:
    """Estimate minus truth at the estimate's own time [m]; NaN where there is no estimate or it is lost."""
    return np.where(np.isfinite(health) & (health < LOST), estimate - truth, np.nan)


def within_sigmas(error: FloatArray, std: FloatArray) -> float:
    """Share of the known errors within 2.5 stated standard deviations; NaN if none is stated.

    Of normally distributed errors with a right standard deviation it is 0.988. An exact source states 0, and does not
    count.
    """
    stated = np.isfinite(error) & (std > 0.0)
    return float(np.mean(np.abs(error[stated]) <= _SIGMAS * std[stated])) if stated.any() else float("nan")


def nees(error: FloatArray, std: FloatArray) -> float:
    """Normalised estimation error squared, in the mean: 1 for a right standard deviation; NaN if none is stated."""
    stated = np.isfinite(error) & (std > 0.0)
    return float(np.mean(np.square(error[stated] / std[stated]))) if stated.any() else float("nan")


def longest_loss(health: FloatArray, time: FloatArray) -> float:
    """Longest time without a usable value, from the last usable capture to the next one [s]; NaN without captures.

    Captures before the first usable one do not count. A loss at the end lasts until the last capture.
    """
    captures = np.flatnonzero(np.isfinite(health))
    usable = captures[health[captures] < LOST]
    if not usable.size:
        return float("nan")
    ends = np.append(usable, captures[-1])
    places = np.searchsorted(captures, ends)
    lost = np.diff(places) > 1  # a capture without a value lies between
    lost[-1] |= places[-1] > places[-2]
    return float(np.max(np.diff(time[ends])[lost], initial=0.0))


def valid_fraction(health: FloatArray, truth: FloatArray) -> float:
    """Share of the expected estimates that are not lost; NaN if none is expected.

    Estimates are expected from the second capture on at which the true off-tracking is defined.
    """
    captures = np.flatnonzero(np.isfinite(health))
    expected = captures[np.isfinite(truth[captures])][1:]
    return float(np.mean(health[expected] < LOST)) if expected.size else float("nan")


def rate(values: FloatArray, time: FloatArray) -> FloatArray:
    """Rate of change between neighbouring samples, shape (n - 1,)."""
    change: FloatArray = np.diff(values) / np.diff(time)
    return change


def odometry_drift(true_poses: FloatArray, motions: FloatArray, lost: NDArray[np.bool_], length: float) -> FloatArray:
    """Position error of the chained odometry over ``length`` of travel, as a share of the distance, for every start.

    Args:
        true_poses: x [m], y [m], psi [rad] of the trailer at every capture, shape (n, 3).
        motions: estimated motion from the capture before, x and y [m] along the trailer's axes there and change of
            yaw [rad], shape (n, 3). The first is not used.
        lost: True for motions without information, shape (n,).
        length: distance over which the motions are chained [m]; the trailer's follow distance, as only errors over
            the last length of the trailer enter the off-tracking.

    Stretches that are too short or contain a lost motion are left out.
    """
    true_path = true_poses[:, 0] + 1j * true_poses[:, 1]
    usable = np.where(lost[:, None], 0.0, motions)
    yaw = np.cumsum(usable[:, 2])
    steps = np.exp(1j * np.concatenate([[0.0], yaw[:-1]])) * (usable[:, 0] + 1j * usable[:, 1])
    path = np.cumsum(steps)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(true_path)))])
    start = np.arange(len(travelled))
    end = np.searchsorted(travelled, travelled + length)
    gaps = np.cumsum(lost)
    whole = end < len(travelled)
    start, end = start[whole], end[whole]
    start, end = start[gaps[end] == gaps[start]], end[gaps[end] == gaps[start]]
    estimated = (path[end] - path[start]) * np.exp(-1j * yaw[start])
    true = (true_path[end] - true_path[start]) * np.exp(-1j * true_poses[start, 2])
    share: FloatArray = np.abs(estimated - true) / (travelled[end] - travelled[start])
    return share
