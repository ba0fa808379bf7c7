"""The driver as a scenario file describes him."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, field_validator

from scenarios.options.base import Options, quantity


class StopTable(Options):
    """A standstill on the way, and a way back from it."""

    station: float = quantity(0.0, "m", ge=1.0, le=1e5)  # of the guided point along the course
    wait: float = quantity(3.0, "s", ge=0.0, le=60.0)  # how long he stands, there and at the end of a way back
    back: float = quantity(0.0, "m", ge=0.0, le=100.0)  # how far he reverses from there before he goes on


class DriverOptions(Options):
    """The driver: follows the course at set speed, slower where a limit says so, or repeats a recorded drive."""

    kind: str | None = None  # preview, recorded or package.module:Name; not given: recorded if there is a trace
    parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)  # of a driver of one's own
    max_lateral_acceleration: float | None = quantity(None, "m/s2", ge=0.05, le=10.0)  # he slows down to in turns
    stops: tuple[StopTable, ...] = Field(default=(), max_length=50)
    trace: str | None = None  # CSV file: time_s, steer_deg, and speed_kmh or acceleration (m/s2)

    @field_validator("trace")
    @classmethod
    def _from_any_folder(cls, trace: str | None) -> str | None:
        return None if trace is None else str(Path(trace).resolve())


def _table(driver: Any) -> Any:
    return {"kind": driver} if isinstance(driver, str) else driver


DriverTable = Annotated[DriverOptions, BeforeValidator(_table)]  # ``driver = "name"`` is short for its kind
