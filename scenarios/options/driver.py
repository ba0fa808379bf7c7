"""The driver as a scenario file describes him."""

from __future__ import annotations

from pathlib import Path

from pydantic import field_validator

from scenarios.options.base import Options, quantity


class DriverOptions(Options):
    """He follows the course at set speed, slower where a limit says so, or repeats a recorded drive."""

    max_lateral_acceleration: float | None = quantity(None, "m/s2", ge=0.05, le=10.0)  # he slows down to in turns
    trace: str | None = None  # CSV file: time_s, steer_deg, and speed_kmh or acceleration (m/s2)

    @field_validator("trace")
    @classmethod
    def _from_any_folder(cls, trace: str | None) -> str | None:
        return None if trace is None else str(Path(trace).resolve())
