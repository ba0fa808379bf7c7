"""Names of the fault kinds. A new kind is one class and one line here."""

from __future__ import annotations

import inspect
from typing import Final, TypeGuard

from sensors.faults.fault import FaultKind

FAULTS: Final = {
    "dropout": "sensors.faults.message_kinds:Dropout",
    "duplicate": "sensors.faults.message_kinds:Duplicate",
    "freeze": "sensors.faults.message_kinds:Freeze",
    "delay": "sensors.faults.message_kinds:Delay",
    "desync": "sensors.faults.stereo_kinds:Desync",
    "decalibration": "sensors.faults.stereo_kinds:Decalibration",
    "dirt": "sensors.faults.image_kinds:Dirt",
    "glare": "sensors.faults.image_kinds:Glare",
    "gain": "sensors.faults.image_kinds:Gain",
    "blackout": "sensors.faults.image_kinds:Blackout",
    "articulation_offset": "sensors.faults.signal_kinds:ArticulationOffset",
    "articulation_stuck": "sensors.faults.signal_kinds:ArticulationStuck",
    "gyro_bias": "sensors.faults.signal_kinds:GyroBias",
    "gyro_drift": "sensors.faults.signal_kinds:GyroDrift",
    "wheel_speed_dropout": "sensors.faults.signal_kinds:WheelSpeedDropout",
}


def checked_kind(name: str, part: object) -> type[FaultKind]:
    """The part, if it is a fault kind.

    Raises:
        ValueError: one line naming the members that are missing.
    """
    if not _is_kind(part):
        missing = [member for member in _MEMBERS if not hasattr(part, member)]
        raise ValueError(f"{name} is no fault kind: {', '.join(missing) or 'it is no class'} missing")
    return part


_MEMBERS: Final = ("options", "needs", "applies_to", "sample")


def _is_kind(part: object) -> TypeGuard[type[FaultKind]]:
    return inspect.isclass(part) and all(hasattr(part, member) for member in _MEMBERS)
