"""Combinations of vehicles as data: the validated contents of a vehicle file, and the sources of its numbers.

Without ABS an axle, or a group of axles, has one channel. With it, a modulator is a channel: of one wheel, of the
wheels on one side of a group, or of all its wheels.

A number in a vehicle file is either plain or ``{ value = ..., source = "..." }``. Units are described in ``unit.py``.
"""

from collections.abc import Callable, Iterator
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field, field_validator, model_validator

from vehicle.combination.unit import AxleBrake, Brakes, Unit, grouped
from vehicle.foundation.quantity import Frozen, Lag, checked, quantity
from vehicle.foundation.user_file import ParameterLibrary, nearest, read_toml, sources, without_sources
from vehicle.tyres import Tyre
from vehicle.tyres.laws import TYRES, tyre_law

_FORCE: Final = "1 kN moves a car, 1 MN the heaviest transport"
_POWER: Final = "powers are in W, not kW"


class Retarder(Frozen):
    """Endurance brake on the driven wheels: engine drag, engine brake or retarder.

    If it does not act first, it does a part of the driven axles' own share of a brake demand, so that no force changes.
    """

    max_force: float = quantity(..., "N", 100.0, 1e6, why=_FORCE)  # at the treads
    max_power: float = quantity(..., "W", 1e3, 5e6, why=_POWER)  # at the wheels
    # Below it the force falls to 0 with the speed
    full_speed: float = quantity(..., "m/s", 0.1, 20.0, why="an engine drags from walking pace on")
    acts_first: bool = False  # it does all that it can, and the service brakes the rest; unstable on slippery ground


class Powertrain(Frozen):
    """Engine and gearbox as a force limit, a power limit (``Drive.max_power``) and a governor; continuous ratio."""

    launch_force: float = quantity(..., "N", 100.0, 1e6, why=_FORCE)  # at the treads in the lowest gear
    lowest_gear_speed: float = quantity(
        ..., "m/s", 0.3, 20.0, why="a crawler gear has 0.3 m/s, a car's first gear 15 m/s"
    )  # of the rims at governed engine speed in the lowest gear
    overspeed: float = quantity(
        ..., "-", 1.0, 5.0, why="the governor is above the speed in use; gears span a factor of 2"
    )  # governed engine speed over that at which the gear in use is driven
    # Of the rims in the highest gear at governed engine speed, or at a road speed limiter
    top_speed: float = quantity(..., "m/s", 1.0, 100.0, why="from a transporter's 4 km/h to 360 km/h")
    # Of the rims' speed, over which the torque falls to 0
    governor_band: float = quantity(..., "m/s", 0.1, 5.0, why="a governor takes a few percent of the engine's speed")
    traction_control: bool = True
    traction_slip: float = quantity(..., "-", 0.01, 1.0, why="driven tyres have their peak at 0.05 to 0.3")
    # Added to it: for setting off
    traction_slip_speed: float = quantity(..., "m/s", 0.1, 5.0, why="walking pace at most")
    retarder: Retarder | None = None


class AirDrag(Frozen):
    """Drag of the air on the straight combination."""

    drag_area: float = quantity(..., "m2", 0.1, 30.0, why="drag coefficient times frontal area; cars 0.6 m2")
    density: float = quantity(..., "kg/m3", 0.5, 1.6, why="from 8000 m of height to severe frost")


class BrakeChannel(NamedTuple):
    """Wheels with a common brake pressure."""

    unit: int
    axles: tuple[int, ...]  # numbers in ``Unit.axles``
    brake: AxleBrake  # of the foremost of them
    side: int  # +1 left, -1 right, 0 both
    valve: int | None  # number of its ABS modulator; None: no ABS
    mirrored: int  # number of the channel that is its mirror image


def brake_channels(vehicle: "Vehicle") -> tuple[BrakeChannel, ...]:
    """All brake channels, front to rear, left before right; none if the vehicle describes no brakes."""
    channels: list[BrakeChannel] = []
    for unit, axles, brake in _groups(vehicle):
        with_abs = vehicle.brakes is not None and vehicle.brakes.abs and brake.abs is not None
        sides = (+1, -1) if with_abs and brake.abs == "wheel" else (0,)
        first = len(channels)
        for k, side in enumerate(sides):
            valve = sum(channel.valve is not None for channel in channels) if with_abs else None
            channels.append(BrakeChannel(unit, axles, brake, side, valve, first + len(sides) - 1 - k))
    return tuple(channels)


def channel_of_wheel(vehicle: "Vehicle") -> dict[tuple[int, int, int], int]:
    """Number of the brake channel by unit, axle in it, and side (+1 left, -1 right); wheels without brakes lack."""
    return {
        (channel.unit, axle, side): number
        for number, channel in enumerate(brake_channels(vehicle))
        for axle in channel.axles
        for side in (+1, -1)
        if channel.side in (0, side)
    }


def check_brakes(vehicle: "Vehicle") -> None:
    """Refuse brakes that do not fit together.

    Raises:
        ValueError: one line that names the table.
    """
    if vehicle.brakes is not None and not any(axle.brake for unit in vehicle.units for axle in unit.axles):
        raise ValueError("brakes: no axle has a brake: give axles a table 'brake', or remove [brakes]")
    for i, axles, brake in _groups(vehicle):
        for k in axles[1:]:
            other = vehicle.units[i].axles[k].brake
            if other is not None and _shared(other) != _shared(brake):
                raise ValueError(
                    f"units.{i}.axles.{k}: brakes of abs_group '{brake.abs_group}' must have the same lag, fill_rate "
                    "and abs"
                )


def _shared(brake: AxleBrake) -> tuple[object, ...]:
    return brake.lag, brake.fill_rate, brake.abs


def _groups(vehicle: "Vehicle") -> Iterator[tuple[int, tuple[int, ...], AxleBrake]]:
    """Unit, axles and brake of each group of axles, in the order of their foremost axles."""
    if vehicle.brakes is None:
        return
    for i, unit in enumerate(vehicle.units):
        for axles in grouped({k: axle.brake.abs_group for k, axle in enumerate(unit.axles) if axle.brake is not None}):
            brake = unit.axles[axles[0]].brake
            if brake is not None:
                yield i, axles, brake


GRAVITY: Final = 9.81  # [m/s2]

_GRIP: Final = "tyres hold 1.5 times the weight at most, 15 m/s2"
_LIGHTEST_TRACTOR: Final = 300.0  # [kg]
_VEHICLES: Final = ParameterLibrary("vehicle", "parameters", "eu_tractor_semitrailer")


class Drive(Frozen):
    """Limits and lag of driveline and brakes under a demanded acceleration."""

    lag: Lag  # first-order time constant of torque build-up
    max_acceleration: float = quantity(..., "m/s2", 0.0, 15.0, above=True, why=_GRIP)
    # At the wheels
    max_power: float = quantity(..., "W", 1e3, 5e6, why="1 kW moves the lightest vehicle; powers are in W, not kW")
    # Demanded by a full brake application
    max_deceleration: float = quantity(..., "m/s2", 0.0, 15.0, above=True, why=_GRIP)


class Vehicle(Frozen):
    """A combination: the tractor and the units it tows, front to rear."""

    name: str
    summary: str = ""
    drive: Drive
    powertrain: Powertrain | None = None  # None: mass times demand up to ``Drive.max_power``, no governor
    air: AirDrag | None = None  # None: no drag of the air
    brakes: Brakes | None = None  # None: braking forces in proportion to static loads, without limit or ABS
    units: Annotated[tuple[Unit, ...], Field(min_length=1)]
    exposed: bool = False  # to wind, see ``in_wind``; without it, nothing of the wind is computed
    has_torque_inputs: bool = False  # see ``with_torque_inputs``
    has_failing_brakes: bool = False  # see ``with_failing_brakes``

    @field_validator("has_torque_inputs", "has_failing_brakes")
    @classmethod
    def _is_no_data(cls, given: bool) -> bool:
        if given:
            raise ValueError("is no data of a vehicle: leave it out")
        return given

    @property
    def mass(self) -> float:
        """Mass of the whole combination [kg]."""
        return sum(unit.mass for unit in self.units)

    @property
    def origins(self) -> tuple[float, ...]:
        """Positions of the units' origins in the tractor's frame, combination straight [m]."""
        return tuple(accumulate(self.hitch_levers(len(self.units) - 1), initial=0.0))

    @property
    def length(self) -> float:
        """Overall length of the straight combination [m]."""
        rears = [origin + unit.rear_x for origin, unit in zip(self.origins, self.units, strict=True)]
        return self.units[0].front_x - min(rears)

    def check_towed(self, unit: int) -> None:
        """Refuse the index of a unit that is not towed.

        Raises:
            ValueError: if the unit is not towed.
        """
        if not 1 <= unit < len(self.units):
            raise ValueError(f"unit = {unit} must be a towed unit of {self.name}, 1 to {len(self.units) - 1}")

    def hitch_levers(self, unit: int) -> list[float]:
        """Rear hitches of the units ahead of a unit, each before the origin of its own unit [m]."""
        return [ahead.rear_hitch[0] for ahead in self.units[:unit]]

    def supports(self, unit: int) -> tuple[float, float]:
        """Positions along x of a unit's supports, front and rear [m]: hitch and axles if towed, else its axles."""
        axles = self.units[unit].axles
        if unit == 0:
            return axles[0].x, axles[-1].x
        return 0.0, sum(axle.x for axle in axles) / len(axles)

    @property
    def n_by_law(self) -> int:
        """Number of all axles that steering laws turn: they come last among the steered ones, front to rear."""
        return sum(len(unit.steered_axles) for unit in self.units) - self.units[0].n_by_driver

    def law_axles(self, unit: int) -> slice:
        """Place of the axles of a unit that a law turns among all steered axles, front to rear."""
        ahead = sum(len(one.steered_axles) for one in self.units[:unit])
        first = ahead + (self.units[0].n_by_driver if unit == 0 else 0)
        return slice(first, ahead + len(self.units[unit].steered_axles))

    def led(self) -> "Vehicle":
        """The vehicle, if it tows nothing with the frame of its body at the middle of the foremost steered axle.

        That point leads the body as a hitch leads a trailer: the axles behind it and the follow point have negative x.
        """
        if len(self.units) > 1:
            return self
        (unit,) = self.units
        return self.model_copy(update={"units": (unit.shifted(unit.steered_axles[0].x),)})

    def led_unit(self, unit: int) -> Unit:
        """A unit as its steering law sees it: of a first unit without the axles that the driver turns, led at x = 0."""
        whole = self.units[unit]
        if unit > 0:
            return whole
        axles = tuple(axle for axle in whole.axles if axle.steered_by_law or not axle.steered)
        return whole.model_copy(update={"axles": axles, "steering": whole.rear_steering or whole.steering})

    def in_wind(self) -> "Vehicle":
        """The vehicle with inputs of the wind at each unit.

        Raises:
            ValueError: one line, if its file does not say how the wind acts.
        """
        if not any(unit.side_wind for unit in self.units):
            raise ValueError(f"{self.name}: a gust needs the table 'side_wind' of a unit")
        if not self.has_springs:
            raise ValueError(f"{self.name}: a gust needs the tables 'suspension' and 'roll'")
        return self.model_copy(update={"exposed": True})

    def with_torque_inputs(self) -> "Vehicle":
        """The vehicle with inputs for driving and braking torques of every axle, besides those of its own driveline."""
        return self.model_copy(update={"has_torque_inputs": True})

    def with_failing_brakes(self) -> "Vehicle":
        """The vehicle with inputs for the share of its torque that the brake of every wheel has.

        Raises:
            ValueError: one line, if its file describes no brakes.
        """
        if self.brakes is None:
            raise ValueError(f"the file of vehicle {self.name} has no table [brakes]")
        return self.model_copy(update={"has_failing_brakes": True})

    @property
    def has_springs(self) -> bool:
        """True if suspensions in roll are given, False if gradients and frequencies are given instead."""
        return self.units[0].roll is not None

    @property
    def n_wheels(self) -> int:
        """Number of wheels."""
        return 2 * sum(len(unit.axles) for unit in self.units)

    @model_validator(mode="after")
    def _rolls_on_springs_or_gradients(self) -> "Vehicle":
        if self.has_springs or any(axle.suspension for unit in self.units for axle in unit.axles):
            self._check_springs()
            return self
        for k, unit in enumerate(self.units):
            for name in ("roll_gradient", "roll_frequency"):
                if getattr(unit, name) is None:
                    raise ValueError(f"units.{k}: {name} is missing, or tables 'roll' and 'suspension' of every axle")
            if unit.roll is not None or unit.coupling is not None:
                raise ValueError(f"units.{k}: tables 'roll' and 'coupling' need the table 'suspension' of every axle")
        return self

    def _check_springs(self) -> None:
        for k, unit in enumerate(self.units):
            axles = sorted((*unit.axles, *unit.lifted_axles), key=lambda axle: -axle.x)
            missing = [f"units.{k}.axles.{n}.suspension" for n, axle in enumerate(axles) if axle.suspension is None]
            if unit.roll is None:
                missing.append(f"units.{k}.roll")
            if missing:
                raise ValueError(f"table '{missing[0]}' is missing: suspensions are given for all axles or for none")
            for name, short in (("roll_gradient", None), ("roll_frequency", None), ("hitch_roll_share", 0.0)):
                if getattr(unit, name) != short:
                    raise ValueError(f"units.{k}: {name} follows from the suspensions: leave out one of the two")
            if k == 0 and unit.coupling is not None:
                raise ValueError("units.0: table 'coupling' belongs to the towed unit whose front hitch it is")

    @model_validator(mode="after")
    def _is_a_chain(self) -> "Vehicle":
        tractor, towed = self.units[0], self.units[1:]
        if tractor.mass < _LIGHTEST_TRACTOR:
            lightest = f"{_LIGHTEST_TRACTOR:g} kg, the lightest motor vehicle on four wheels"
            raise ValueError(f"units.0.mass = {tractor.mass:g} must be at least {lightest}; masses are in kg, not t")
        names = [unit.name.replace(" ", "_") for unit in self.units]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"units: two have the name '{name}': each needs its own, which its signals carry")
        if not tractor.n_by_driver:
            raise ValueError("units.0: the tractor needs a steered axle")
        by_law = [axle.steered_by_law for axle in tractor.steered_axles]
        if by_law != sorted(by_law) or any(axle.steered_by_law for axle in tractor.axles if not axle.steered):
            raise ValueError("units.0: axles with steered_by_law = true are steered ones behind those of the driver")
        if any(len({tractor.axles[k].steered_by_law for k in one.axles}) > 1 for one in tractor.actuators):
            raise ValueError("units.0: an actuator turns axles of the driver or axles of a law, not both")
        if not any(axle.driven for axle in tractor.axles):
            raise ValueError("units.0: the tractor needs a driven axle")
        if len(tractor.axles) < 2:
            raise ValueError("units.0: the tractor needs two axles or more to stand on")
        for k, unit in enumerate(self.units[:-1]):
            if unit.hitch_x is None:
                raise ValueError(f"units.{k}: hitch_x [m] is missing, yet another unit follows")
        for k, unit in enumerate(towed, start=1):
            if unit.rear_steering is not None or any(axle.steered_by_law for axle in unit.axles):
                raise ValueError(f"units.{k}: laws turn all steered axles of a towed unit: leave out steered_by_law")
            if any(axle.x >= 0.0 for axle in unit.axles):
                raise ValueError(f"units.{k}: axles of a towed unit lie behind its hitch: x must be below 0 m")
            if any(axle.driven for axle in unit.axles):
                raise ValueError(f"units.{k}: only axles of the tractor can be driven")
            if unit.follow_x is not None and unit.follow_x >= 0.0:
                raise ValueError(f"units.{k}: follow_x = {unit.follow_x:g} m must be below 0 m, behind the hitch")
        check_brakes(self)
        return self


def vehicle_names() -> tuple[str, ...]:
    """Names of the vehicles in the library."""
    return _VEHICLES.names()


def load_vehicle(name_or_path: str) -> Vehicle:
    """The vehicle of this name, or the one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = vehicle_file(name_or_path)
    return vehicle_from(without_sources(read_toml(path)), str(path))


def vehicle_file(name_or_path: str) -> Path:
    """File of the vehicle of this name; a path that ends in ``.toml`` is returned as it is.

    Raises:
        ValueError: one line with the nearest known name.
    """
    return _VEHICLES.file(name_or_path)


def vehicle_from(contents: dict[str, Any], file: str) -> Vehicle:
    """Build a vehicle from the contents of its file, sources removed.

    Raises:
        ValueError: one line naming file, key, value, limit and unit.
    """
    with_tyres = _with_tables(contents, file, "tyres", "tyre", _tyre)
    complete = _with_tables(with_tyres, file, "axle_brakes", "brake", _axle_brake)
    return checked(Vehicle, complete, file, usual=_VEHICLES.usual)


def vehicle_sources(name_or_path: str) -> dict[str, str]:
    """Sources of a vehicle's numbers, by dotted key in its file.

    Raises:
        ValueError: if there is no such vehicle or file.
    """
    return sources(read_toml(vehicle_file(name_or_path)))


def _with_tables(
    contents: dict[str, Any],
    file: str,
    tables: str,
    field: str,
    build: Callable[[dict[str, Any], str, str, str], object],
) -> dict[str, Any]:
    """The contents with the data of table ``[tables.name]`` in place of each axle's ``field = "name"``.

    ``build`` makes them of a table, the file, the table's key, and its name.
    """

    def built(table: object, key: str, name: str = "") -> object:
        if not isinstance(table, dict):
            raise ValueError(f"{file}: {key}: must be a table")
        return build(table, file, key, name)

    given = contents.get(tables, {})
    if not isinstance(given, dict):
        raise ValueError(f"{file}: {tables}: must be tables [{tables}.name]")
    known = {name: built(table, f"{tables}.{name}", name) for name, table in given.items()}
    for key, axle in _axles(contents):
        value = axle.get(field)
        if isinstance(value, dict):
            axle[field] = built(value, f"{key}.{field}")
        elif isinstance(value, str):
            if value not in known:
                raise ValueError(
                    f"{file}: {key}.{field} = '{value}': no table [{tables}.{value}]{nearest(value, known)}"
                )
            axle[field] = known[value]
    return {key: value for key, value in contents.items() if key != tables}


def _tyre(table: dict[str, Any], file: str, key: str, name: str) -> Tyre:
    """Tyre data from a table, by the law that it names."""
    if "law" in table and "model" not in table:
        table = {"model": table["law"], **{word: value for word, value in table.items() if word != "law"}}
    if "file" in table:
        from vehicle.tyres.property_file import tyre_of_file

        return tyre_of_file({"name": name, "model": "magic_formula", **table}, file, key)
    if "model" not in table:
        raise ValueError(f"{file}: key '{key}.model' is missing: one of {', '.join(TYRES)}")
    model, law = table["model"], tyre_law(table["model"])
    if law is None:
        raise ValueError(f"{file}: {key}.model = {model!r} is not a tyre law{nearest(str(model), TYRES)}")
    return checked(law, {"name": name, **table}, file, key, _VEHICLES.usual)


def _axle_brake(table: dict[str, Any], file: str, key: str, _: str) -> AxleBrake:
    return checked(AxleBrake, table, file, key)


def _axles(plain: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Dotted key and table of every axle; entries of another shape are left for the models to refuse."""
    units = plain.get("units")
    for i, unit in enumerate(units if isinstance(units, list) else ()):
        axles = unit.get("axles") if isinstance(unit, dict) else None
        for k, axle in enumerate(axles if isinstance(axles, list) else ()):
            if isinstance(axle, dict):
                yield f"units.{i}.axles.{k}", axle
