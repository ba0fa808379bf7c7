"""Data of service brakes: of every axle, and of the system that controls them."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from vehicle.parameter_file import checked, nearest
from vehicle.quantities import Flag, Fraction, Frozen, quantity

Modulation = Literal["wheel", "select_low"]
Distribution = Literal["load", "pressure"]

_TORQUE: Final = "10 N m is a hand cart's brake, 5e5 a dumper's"

AirLag = Annotated[float, quantity("s", ge=0.01, le=2.0, why="no brake answers within 10 ms or after 2 s")]


class AxleBrake(Frozen):
    """Service brake of an axle with two equal wheels."""

    torque: Annotated[float, quantity("N m", ge=10.0, le=5e5, why=_TORQUE)]  # of both wheels at full pressure
    lag: AirLag  # first-order time constant of the pressure in the chambers
    fill_rate: Annotated[
        float, quantity("1/s", ge=0.1, le=50.0, why="pressure builds up in 0.02 s to 10 s")
    ]  # at most, of the pressure over the full one
    abs: Modulation | None = None  # "wheel": each side has its modulator; "select_low": one, led by the slower side
    abs_group: str | None = None  # axles of a unit with the same name share their modulators


class Brakes(Frozen):
    """The system that controls the service brakes of a combination."""

    distribution: Distribution  # "load": forces in proportion to static loads, as EBS does; "pressure": equal pressure
    lag: AirLag  # from the pedal to the valves of the axles, first order
    abs: Flag = True
    abs_slip: Fraction  # slip at which a modulator releases the pressure
    abs_slip_speed: Annotated[
        float, quantity("m/s", ge=0.05, le=5.0, why="below it wheels may lock")
    ]  # added to it: slower wheels may lock
    abs_hysteresis: Fraction  # share of that limit by which the slip must fall until the modulator lets pressure in
    abs_lead: Annotated[
        float, quantity("s", ge=0.0, le=0.2, why="a wheel locks within 0.2 s")
    ]  # slip is predicted so far ahead from the spin's rate
    abs_release_lag: Annotated[
        float, quantity("s", ge=0.01, le=1.0, why="no chamber empties within 10 ms; slower wheels lock")
    ]  # first order, of the pressure let out by ABS
    abs_valve_lag: Annotated[
        float, quantity("s", ge=0.002, le=0.1, why="solenoid valves take some ms")
    ]  # of the modulator's valves


def with_brakes(contents: dict[str, Any], axles: list[tuple[str, dict[str, Any]]], file: str) -> dict[str, Any]:
    """The contents with the data of table ``[axle_brakes.name]`` in place of each axle's ``brake = "name"``.

    ``axles`` are the dotted key and the table of every axle in the contents.

    Raises:
        ValueError: one line, if a table is not valid or there is none of a name.
    """
    tables = contents.get("axle_brakes", {})
    if not isinstance(tables, dict):
        raise ValueError(f"{file}: axle_brakes: must be tables [axle_brakes.name]")
    known = {name: _axle_brake(table, file, f"axle_brakes.{name}") for name, table in tables.items()}
    for key, axle in axles:
        brake = axle.get("brake")
        if isinstance(brake, dict):
            axle["brake"] = _axle_brake(brake, file, f"{key}.brake")
        elif isinstance(brake, str):
            if brake not in known:
                hint = nearest(brake, known)
                raise ValueError(f"{file}: {key}.brake = '{brake}': no table [axle_brakes.{brake}]{hint}")
            axle["brake"] = known[brake]
    return {key: value for key, value in contents.items() if key != "axle_brakes"}


def _axle_brake(table: object, file: str, key: str) -> AxleBrake:
    if not isinstance(table, dict):
        raise ValueError(f"{file}: {key}: must be a table")
    return checked(AxleBrake, table, file, key)
