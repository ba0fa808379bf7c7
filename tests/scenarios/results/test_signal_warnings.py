"""Warnings about signals that were found at fault."""

from __future__ import annotations

from estimators.off_tracking.signal_monitor import Finding
from scenarios.results.run_warnings import signal_warnings


def test_each_signal_has_a_line_with_its_times() -> None:
    """A fault that ended and came back, and one that stays."""
    findings = [
        Finding(1200, "wheel speed", True),
        Finding(3000, "wheel speed", False),
        Finding(4000, "steer angle", True),
        Finding(5000, "wheel speed", True),
    ]
    assert list(signal_warnings(findings)) == [
        "wheel speed distrusted from 1.2 s to 3.0 s, from 5.0 s: it contradicts the other signals; corrected",
        "steer angle distrusted from 4.0 s: it contradicts the other signals; corrected",
    ]
