"""Warnings about signals of the combination that were found at fault during a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from estimators.off_tracking.signal_monitor import Finding
from vehicle.clock import TICK


def signal_warnings(findings: Sequence[Finding]) -> Iterator[str]:
    """A line for every signal, with the times at which it was distrusted."""
    for signal in dict.fromkeys(finding.signal for finding in findings):
        times = ", ".join(
            f"{'from' if finding.at_fault else 'to'} {finding.tick * TICK:.1f} s"
            for finding in findings
            if finding.signal == signal
        )
        yield f"{signal} distrusted {times.replace(', to', ' to')}: it contradicts the other signals; corrected"
