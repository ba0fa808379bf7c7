"""Warnings about steering actuators that did not follow their demands during a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from controllers.trailer_steering.actuator_faults import Kind
from controllers.trailer_steering.actuator_monitor import ActuatorFinding
from vehicle.clock import TICK

_SOUND: Final[Kind] = "sound"
_MEANING: Final[Mapping[Kind, str]] = {
    "stuck": "stuck",
    "dead": "it returned to straight, without power",
    "slow": "slow",
    "offset": "an offset; corrected",
    "late": "late",
}


def actuator_warnings(findings: Sequence[ActuatorFinding]) -> Iterator[str]:
    """A line for every actuator: when it did not follow its demands, and why."""
    for axles in dict.fromkeys(finding.axles for finding in findings):
        name = ("axle " if len(axles) == 1 else "axles ") + " and ".join(map(str, axles))
        follows = "does not follow its demand" if len(axles) == 1 else "do not follow their demand"
        yield f"{name}: {follows} {'; '.join(_periods(f for f in findings if f.axles == axles))}"


def _periods(findings: Iterator[ActuatorFinding]) -> Iterator[str]:
    """Periods at fault; a kind that was named first and corrected later is not told."""
    begin, kind = 0, _SOUND
    for finding in findings:
        if kind == _SOUND:
            begin = finding.tick
        elif finding.kind == _SOUND:
            yield f"from {begin * TICK:.1f} s to {finding.tick * TICK:.1f} s ({_MEANING[kind]})"
        kind = finding.kind
    if kind != _SOUND:
        yield f"from {begin * TICK:.1f} s ({_MEANING[kind]})"
