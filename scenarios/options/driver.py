"""Options of the driver."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from scenarios.options.base import FullPath, Options, PartName, option, quantity


class StopTable(Options):
    """A stop on the course, with reversing if asked for."""

    station: float = quantity(
        0.0, "m", 1.0, 1e5, "Position of the guided point along the course where the driver stops."
    )
    wait: float = quantity(3.0, "s", 0.0, 60.0, "Duration of the standstill, also after reversing.")
    back: float = quantity(0.0, "m", 0.0, 100.0, "Distance that the driver reverses before continuing.")


class DriverOptions(Options):
    """The driver: follows the course at set speed or below a lateral limit, or repeats a recorded drive."""

    kind: PartName | None = option(
        "preview, recorded, package.module:Name or the file of an FMU; not given: recorded if driver.trace is given, "
        "else preview.",
        None,
    )
    parameters: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="Parameters of the user's own driver."
    )
    max_lateral_acceleration: float | None = quantity(
        None,
        "m/s2",
        0.05,
        10.0,
        "Limit of lateral acceleration; the driver slows down in turns to keep it; not given: no limit.",
    )
    stops: tuple[StopTable, ...] = Field(
        default=(), max_length=50, description="Standstills on the course, each with station, wait and back."
    )
    trace: FullPath | None = option(
        "CSV file of a recorded drive with time_s, steer_deg, and speed_kmh or acceleration [m/s2].", None
    )


def _table(driver: Any) -> Any:
    return {"kind": driver} if isinstance(driver, str) else driver


DriverTable = Annotated[DriverOptions, BeforeValidator(_table)]  # ``driver = "name"`` is short for its kind
