"""Schedule of a rig of cameras, synchronous with the loop or the environment that samples it."""

from __future__ import annotations

from scenarios.options.rig import RigOptions
from scenarios.options.rover import TraceRigOptions
from vehicle.clock import TICK, Schedule


def rig_schedule(rig: RigOptions | TraceRigOptions, step: int = 1) -> Schedule:
    """Schedule of the cameras, with the latency of estimates, in steps of this many ticks.

    Raises:
        ValueError: one line, if period or latency is not a multiple of the step.
    """
    schedule = Schedule.at_rate(rig.rate_hz, latency=rig.latency, name="rig.rate_hz")
    check_schedule(schedule, step)
    return schedule


def check_schedule(schedule: Schedule, step: int, *, step_name: str = "") -> None:
    """Refuse cameras that are not synchronous with steps of this many ticks.

    Raises:
        ValueError: one line.
    """
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % step:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of {step_name}{step * TICK:g} s")
