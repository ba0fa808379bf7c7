"""Warnings about steering actuators that did not follow their demands."""

from __future__ import annotations

from controllers.trailer_steering.actuators import ActuatorFinding
from scenarios.results.run_warnings import actuator_warnings


def test_a_line_for_every_actuator_with_periods_and_kinds() -> None:
    """A kind that was corrected while the fault went on is not told."""
    findings = (
        ActuatorFinding(1200, (2,), "slow"),
        ActuatorFinding(1500, (2,), "stuck"),
        ActuatorFinding(3000, (2,), "sound"),
        ActuatorFinding(4000, (1, 3), "offset"),
        ActuatorFinding(5000, (2,), "dead"),
    )
    assert list(actuator_warnings(findings)) == [
        "axle 2: does not follow its demand from 1.2 s to 3.0 s (stuck); "
        "from 5.0 s (it returned to straight, without power)",
        "axles 1 and 3: do not follow their demand from 4.0 s (an offset; corrected)",
    ]
