"""Bands along the time axis: health of an estimate, and faults of the scenario."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator

import numpy as np

from estimators.estimates import Health
from scenarios.player.playback import Colour, Span
from scenarios.results.log import HEALTH, HEALTH_WORDS, LOST, OK, Log

_DEGRADED = HEALTH[Health.DEGRADED]
_COLOURS: dict[str, Colour] = {"ok": "ok", "degraded": "degraded", "lost": "lost"}


def health_spans(log: Log, signal: str) -> Iterator[Span]:
    """Times at which the estimate's health is not "ok", each from its capture to the next."""
    if signal not in log or not len(log):
        return
    health = log[signal]
    captures = np.flatnonzero(np.isfinite(health))
    if not captures.size:
        return
    edges = np.append(log["time"][captures], log["time"][-1])
    values = np.where(health[captures] >= LOST, LOST, np.where(health[captures] > OK, _DEGRADED, OK))
    first = 0
    for k in range(1, len(values) + 1):
        if k == len(values) or values[k] != values[first]:
            if values[first] != OK:
                word = HEALTH_WORDS[float(values[first])]
                yield Span(f"estimate {word}", _COLOURS[word], float(edges[first]), float(edges[k]))
            first = k


def fault_spans(scenario_toml: str, log: Log) -> Iterator[Span]:
    """The faults that the scenario names, from their start to their end."""
    try:
        faults = tomllib.loads(scenario_toml).get("faults", ())
    except tomllib.TOMLDecodeError:
        return
    end = float(log["time"][-1]) if len(log) else 0.0
    for fault in faults if isinstance(faults, list) else ():
        start = float(fault.get("start", 0.0))
        if start < end:
            stop = min(end, start + float(fault.get("duration", end)))
            yield Span(f"fault {fault.get('kind', '')}", "fourth", start, stop)
