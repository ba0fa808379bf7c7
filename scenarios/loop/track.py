"""Track of a trailer in a run: its estimates, and who steered it by what, row by row of the log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scenarios.assembly.trailer import LOG_PERIOD, trailer_stream
from scenarios.loop.combination import TrailerSession
from scenarios.loop.pilot import SteeredTrailer
from scenarios.results.reference_unit import ReferenceOffTracking
from scenarios.results.trailer_signals import TrailerTrack
from vehicle.frames import FloatArray


def track_of(session: TrailerSession, trailer: SteeredTrailer, *, with_unit: bool) -> TrailerTrack:
    """A trailer's estimates, and the reference unit on it if there is one."""
    watched, cameras = trailer.trailer, trailer.trailer.sensing.cameras
    n, has_faults = len(session.rows), bool(session.parts.scenario.faults)
    return TrailerTrack(
        name=watched.name,
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        steers_ahead=watched.steers_ahead,
        n_steered=watched.n_steered,
        estimates=trailer.estimates,
        X_SC=cameras.calibration.X_SC if cameras else None,
        reference=_reference(session, trailer) if with_unit else None,
        fallback=_fallback(trailer, n) if has_faults else None,
        distrusted=_distrusted(trailer, n) if has_faults else None,
        axles_at_fault=_axles_at_fault(trailer, n) if has_faults else None,
    )


def _reference(session: TrailerSession, trailer: SteeredTrailer) -> ReferenceOffTracking:
    parts, watched = session.parts, trailer.trailer
    return ReferenceOffTracking(
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        rng=trailer_stream(parts.seed, parts.vehicle, watched.unit, "reference unit"),
    )


def _fallback(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """1 in rows in which the fallback steers the trailer, 0 in others."""
    ticks = [tick for tick, _ in trailer.handovers]
    states = np.array([0.0, *(float(by_fallback) for _, by_fallback in trailer.handovers)])
    return _in_rows(n_rows, ticks, states)


def _distrusted(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of signals that the guard of a trailer's law holds to be at fault in each row."""
    findings = sorted(trailer.findings, key=lambda finding: finding.tick)
    counts = np.cumsum([0.0, *(1.0 if finding.at_fault else -1.0 for finding in findings)])
    ticks = [finding.tick for finding in findings]
    return _in_rows(n_rows, ticks, counts)


def _axles_at_fault(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of axles that do not follow their demands, as the supervision of a trailer's law holds, in each row."""
    counts, findings = np.zeros(n_rows), trailer.actuator_findings
    for axles in dict.fromkeys(finding.axles for finding in findings):
        own = [finding for finding in findings if finding.axles == axles]
        states = np.array([0.0, *(float(len(axles) * (finding.kind != "sound")) for finding in own)])
        ticks = [finding.tick for finding in own]
        counts += _in_rows(n_rows, ticks, states)
    return counts


def _in_rows(n_rows: int, ticks: Sequence[int], states: FloatArray) -> FloatArray:
    """State in each row: the first of ``states`` (n + 1,), and from each of the n ``ticks`` on the next one."""
    return states[np.searchsorted(ticks, LOG_PERIOD * np.arange(n_rows), side="right")]
