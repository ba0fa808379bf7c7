"""Options of the driver, of demands from outside, and of the simulated vehicle."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field

from scenarios.options.base import FullPath, PartName
from vehicle.combination.variants import NamedChanges
from vehicle.foundation.quantity import Frozen, option, quantity


class StopTable(Frozen):
    """A stop on the course, with reversing if asked for."""

    station: float = quantity(
        0.0, "m", 1.0, 1e5, "Position of the guided point along the course where the driver stops."
    )
    wait: float = quantity(3.0, "s", 0.0, 60.0, "Duration of the standstill, also after reversing.")
    back: float = quantity(0.0, "m", 0.0, 100.0, "Distance that the driver reverses before continuing.")


class DriverOptions(Frozen):
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


class OutsideOptions(Frozen):
    """Demands from outside by ``--udp`` or ``--can``; the scenario's own law or driver stands in where they fail."""

    demands: Literal["none", "trailer", "driver", "both"] = option(
        "Parts that are steered from outside: the trailers' axles, the tractor by its driver, or both.", "none"
    )
    hold: float = quantity(
        0.1, "s", 0.0, 10.0, "Time that a demand holds when no new one comes; then the scenario's own part takes over."
    )
    wait: float = quantity(
        0.0, "s", 0.0, 10.0, "Longest time that the loop waits for the answer to the signals it has just sent."
    )
    record: FullPath | None = option(
        "CSV file of the demands that came in an earlier run, which are repeated; a run directory has one.", None
    )


class PlantOptions(NamedChanges):
    """Changes of the simulated vehicle: named ones, or any number of the vehicle file by its path."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, strict=True)

    kind: str | None = option("multibody, constant_slip or package.module:Name; not given: as the course needs.", None)
    fmu: FullPath | None = option("FMU that simulates the vehicle; the scenario's vehicle stays its data sheet.", None)

    def changes(self) -> dict[str, Any]:
        """Changes of the vehicle that are not at their defaults."""
        fields = type(self).model_fields
        values = {name: value for name, value in self if name not in ("kind", "fmu")}
        return {name: value for name, value in values.items() if name not in fields or value != fields[name].default}


class BrakeOptions(Frozen):
    """Electronic systems of brakes and drive; those not given are as in the vehicle file."""

    abs: bool | None = option("Anti-lock braking; not given: as in the vehicle file.", None)
    traction_control: bool | None = option(
        "Traction control of the driven wheels; not given: as in the vehicle file.", None
    )
