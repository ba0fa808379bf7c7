"""Names of the fault kinds of the loop. A new kind is one class and one line here."""

from __future__ import annotations

import inspect
from typing import Final, TypeGuard

from scenarios.loop_faults.fault import ActuatorFault, BrakeShares, LoopFaultKind, MessageFault

LOOP_FAULTS: Final = {
    "estimate_loss": "scenarios.loop_faults.message_kinds:EstimateLoss",
    "estimate_delay": "scenarios.loop_faults.message_kinds:EstimateDelay",
    "demand_loss": "scenarios.loop_faults.message_kinds:DemandLoss",
    "demand_delay": "scenarios.loop_faults.message_kinds:DemandDelay",
    "actuator_stuck": "scenarios.loop_faults.actuator_kinds:ActuatorStuck",
    "actuator_slow": "scenarios.loop_faults.actuator_kinds:ActuatorSlow",
    "actuator_offset": "scenarios.loop_faults.actuator_kinds:ActuatorOffset",
    "actuator_dead": "scenarios.loop_faults.actuator_kinds:ActuatorDead",
    "brake_fault": "scenarios.loop_faults.brake_kinds:BrakeFault",
}


def is_loop_kind(part: object) -> TypeGuard[type[LoopFaultKind]]:
    """True if the part is a fault kind of the loop: a class of one of the families."""
    return inspect.isclass(part) and issubclass(part, MessageFault | ActuatorFault | BrakeShares)
