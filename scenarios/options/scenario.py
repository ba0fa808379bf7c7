"""A scenario of a combination or a rover: with the seed it determines a run; frozen, checked, from TOML and keys."""

import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, TypeVar
from zlib import crc32

import numpy as np
from pydantic import BaseModel, Field, ValidationError, create_model, field_validator, model_validator

from controllers.trailer_steering.policy import shipped_networks
from controllers.trailer_steering.safeguarded import Degradation
from estimators.off_tracking.viso_ot import VisoOt
from scenarios.catalogue import Catalogue, resolve
from scenarios.options.base import FullPath, PartName, ScenarioTable
from scenarios.options.course import CourseOptions, CourseTable
from scenarios.options.rover_course import RoverCourseOptions, RoverCourseTable
from scenarios.options.shipped import FOLDER, scenario_names, shipped_table
from scenarios.options.tables import (
    BrakeOptions,
    DriverOptions,
    DriverTable,
    Faults,
    GroundRigOptions,
    OutsideOptions,
    PlantOptions,
    RigOptions,
    SignalOptions,
    SteerGroups,
    SurfaceOptions,
    TrafficOptions,
    TrafficTable,
    WindOptions,
    WorldOptions,
)
from scenarios.results.run_inputs import with_neighbours
from vehicle.foundation.quantity import Frozen, Parameter, complaint, option, quantity, tables_in
from vehicle.foundation.user_file import MAX_NESTING, FileKind, full_path, nearest, parsed_toml, read_toml, shown

Compensation = Literal["none", "heading", "crab"]


class MoundOptions(Frozen):
    """A round mound, or with a negative height a crater."""

    x: float = quantity(0.0, "m", -1e3, 1e3, "Position of its centre in W.")
    y: float = quantity(0.0, "m", -1e3, 1e3, "Position of its centre in W.")
    radius: float = quantity(1.0, "m", 0.2, 100.0, "Distance from the centre at which the height is 0.14 of the top.")
    height: float = quantity(0.1, "m", -5.0, 5.0, "Height of the top; negative: a crater.")


class RoverSurfaceOptions(Frozen):
    """The ground: slopes, mounds and soil."""

    soil: str = option("Soil by name (see offtrack parts soil) or TOML file; none: hard ground.", "toyoura_sand")
    friction: float = quantity(0.8, "-", 0.05, 1.5, "Friction of hard ground.")
    cross_fall: float = quantity(0.0, "-", -0.6, 0.6, "Cross slope; the ground falls to the right of W's x.")
    grade: float = quantity(0.0, "-", -0.6, 0.6, "Slope along W's x; the ground rises.")
    slope_from: float | None = quantity(
        None, "m", 0.0, 1e3, "Position along W's x where the slopes begin; not given: everywhere."
    )
    slope_over: float = quantity(1.0, "m", 0.1, 100.0, "Distance over which the slopes build up.")
    mounds: tuple[MoundOptions, ...] = option("Mounds and craters, each with x, y, radius and height.", ())
    height_map: FullPath | None = option("File of heights [m], .npy or comma-separated text, rows of growing y.", None)
    height_map_spacing: float = quantity(0.05, "m", 0.001, 10.0, "Grid spacing of the height map.")
    height_map_x: float = quantity(0.0, "m", -1e4, 1e4, "Position of its first column in W.")
    height_map_y: float = quantity(0.0, "m", -1e4, 1e4, "Position of its first row in W.")


class SandOptions(Frozen):
    """Look of the ground, and the light."""

    terrain: str = option("Look of the sand: uniform, ripples, pebbles and others (see docs/rover.md).", "uniform")
    sun_azimuth_deg: float | None = quantity(
        None, "deg", 0.0, 360.0, "Compass direction of the sun; not given: decided by the seed."
    )
    sun_elevation_deg: float | None = quantity(
        None, "deg", 10.0, 90.0, "Elevation of the sun above the horizon; not given: decided by the seed."
    )


class TraceRigOptions(Frozen):
    """The camera behind the left rear wheel, mounted as in the paper (Reina 2008, section II)."""

    rate_hz: float = quantity(5.0, "Hz", 1.0, 20.0, "Frame rate.")
    latency: float = quantity(0.1, "s", 0.0, 2.0, "Time from exposure to the finished estimate.")
    noise: float = quantity(
        2.0, "grey levels", 0.0, 50.0, "Standard deviation of the image noise that is independent of the light."
    )
    shot_noise: float = quantity(
        3.0, "grey levels", 0.0, 50.0, "Standard deviation of the shot noise of a white pixel."
    )


class RoverSignalOptions(Frozen):
    """Encoders, compass and laser tracker."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of encoders, compass and laser tracker; 1: data sheets, 0: exact."
    )


class RoverScenario(ScenarioTable):
    """One closed-loop run of a rover."""

    vehicle_kind: ClassVar[str] = "rover"  # key of the tables of kinds

    kind: Literal["rover"] = option("rover: a scenario for rovers.")
    name: str = Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9._-]+$", description="Name of the scenario.")
    description: str = option("One line for offtrack scenarios.", "")
    course: RoverCourseTable = option("Path of the rover.")
    vehicle: str = option("Rover by name (see offtrack parts rover) or TOML file.", "el_dorado_ii")
    speed_kmh: float = quantity(0.288, "km/h", 0.05, 1.08, "Set speed of the wheels; 0.288 km/h is 8 cm/s.")
    slip_estimator: str = option(
        "Slip estimator (see offtrack parts slip_estimator) or package.module:Name.", "ftrace_plus"
    )
    estimator: dict[str, Parameter] = option(
        "Parameters of the slip estimator; those not given keep their defaults.", {}
    )
    sensor: str | None = option(
        "Sensor (see offtrack parts rover_sensor) or package.module:Name; not given: the estimator's own.", None
    )
    sensing: dict[str, Parameter] = option("Parameters of the user's own sensor.", {})
    driver: str = option("Rover driver (see offtrack parts rover_driver) or package.module:Name.", "path")
    driving: dict[str, Parameter] = option("Parameters of the rover driver; those not given keep their defaults.", {})
    slip_compensation: Compensation = option(
        "Compensation of the estimated slip: none, by the heading, or by pointing the wheels (crab).", "crab"
    )
    navigation: Literal["odometry", "laser"] = option("Source of the position that the rover steers by.", "odometry")
    surface: RoverSurfaceOptions = RoverSurfaceOptions()
    world: SandOptions = SandOptions()
    rig: TraceRigOptions = TraceRigOptions()
    signals: RoverSignalOptions = RoverSignalOptions()
    faults: Faults = option("Faults of the sensor, as text kind:amount@start+duration or as tables.", ())

    @property
    def speed(self) -> float:
        """Set speed of the wheels [m/s]."""
        return self.speed_kmh / 3.6


_COURSE_KIND: Final = "course.kind"
_MAX_KEY: Final = 200  # characters
_CONTROL: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")  # also bytes that are not UTF-8
_BARE_POINT: Final = re.compile(r"(?P<sign>[+-]?)(?=\.?\d)(?P<whole>\d*)\.(?P<rest>\d*)")  # TOML wants digits around it
_NAMED: Final = ("driver", "traffic")  # tables that the name of their kind may stand for
Table = dict[str, Any]  # parsed TOML; only this module uses it


class PolicyOptions(Frozen):
    """The trained network of ``trailer_steering=policy``."""

    path: str | None = option(
        "File of the trained network, or the name of a shipped one (see docs/environments.md).", None
    )

    @field_validator("path")
    @classmethod
    def _full_path(cls, path: str | None) -> str | None:
        if path is None or path in shipped_networks():
            return path
        return full_path(path)  # the resolved scenario runs from any folder


class Scenario(ScenarioTable):
    """One closed-loop run of a combination."""

    vehicle_kind: ClassVar[str] = "trailer"  # key of the tables of kinds

    name: str = Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9._-]+$", description="Name of the scenario.")
    description: str = option("One line for offtrack scenarios.", "")
    course: CourseTable = option("Course of the guided point of the tractor.")
    vehicle: str = option(
        "Vehicle by name (see offtrack parts vehicle) or TOML file, as controllers know it.", "uk_longer_semitrailer"
    )
    load: Literal["unladen", "half", "full"] = option(
        "Load case, from the payload in the vehicle file; full is the vehicle as its file describes it.", "full"
    )
    speed_kmh: float = quantity(10.0, "km/h", 1.0, 120.0, "Set speed.")
    plant: PlantOptions = PlantOptions()  # differences of the simulated vehicle from the data sheet
    brakes: BrakeOptions = BrakeOptions()  # of the simulated vehicle
    driver: DriverTable = DriverOptions()
    trailer_steering: PartName = option(
        "Trailer steering law (see offtrack parts trailer_steering), package.module:Name or the file of an FMU.",
        "path_preview",
    )
    steering: dict[str, Parameter] = option("Parameters of the law; those not given keep their defaults.", {})
    policy: PolicyOptions = PolicyOptions()
    off_tracking: PartName = option(
        "Off-tracking estimator (see offtrack parts off_tracking), package.module:Name or the file of an FMU.",
        "viso_ot",
    )
    estimator: dict[str, Parameter] = option("Parameters of the estimator; those not given keep their defaults.", {})
    sensor: str | None = option(
        "Sensor (see offtrack parts sensor) or package.module:Name; not given: the estimator's own.", None
    )
    sensing: dict[str, Parameter] = option("Parameters of the user's own sensor.", {})
    # Of ``off_tracking = "viso_ot"``; ``estimator`` has those of others
    viso_ot: VisoOt.Parameters = VisoOt.Parameters()
    odometry: str = option("Stereo odometry (see offtrack parts odometry) or package.module:Name.", "keyframe")
    steer_groups: SteerGroups = option(
        "Grouping of steered trailer axles: as in the vehicle file, one common angle, or an actuator for each axle.",
        "vehicle",
    )
    signals: SignalOptions = SignalOptions()
    surface: SurfaceOptions = SurfaceOptions()
    wind: WindOptions = WindOptions()
    rig: RigOptions = RigOptions()
    ground_rig: GroundRigOptions = GroundRigOptions()  # replaces the rig for ground_watching
    world: WorldOptions = WorldOptions()
    traffic: TrafficTable = TrafficOptions()  # none, following, overtaking, crossing or mixed
    faults: Faults = option("Faults of sensors and loop, as text kind:amount@start+duration or as tables.", ())
    degradation: Degradation = Degradation()  # handling of bad estimates
    outside: OutsideOptions = OutsideOptions()  # demands of a controller on a bench
    reference_unit: bool = option("Carry a GNSS-aided reference unit, to judge estimates as in field tests.", True)

    @model_validator(mode="after")
    def _names_parameters_once(self) -> "Scenario":
        if self.off_tracking == "viso_ot" and self.estimator:
            name = next(iter(self.estimator))
            raise ValueError(f"estimator.{name}: the key is viso_ot.{name}, as off_tracking = viso_ot")
        return self

    @property
    def speed(self) -> float:
        """Set speed [m/s]."""
        return self.speed_kmh / 3.6


AnyScenario = Scenario | RoverScenario
ScenarioT = TypeVar("ScenarioT", Scenario, RoverScenario)


def load_scenario(name_or_path: str, settings: Sequence[str] = ()) -> Scenario:
    """Load a trailer's scenario by name or file, and apply ``KEY=VALUE`` settings.

    Raises:
        ValueError: one line that names the scenario, the key, the value, its limit or the nearest known key.
    """
    refusal = f"scenario {name_or_path} is a rover's; a trailer's is needed"
    return of_kind(load_any_scenario(name_or_path, settings), Scenario, refusal)


def of_kind(scenario: AnyScenario, model: type[ScenarioT], refusal: str) -> ScenarioT:
    """The scenario, if it is one of this model.

    Raises:
        ValueError: with ``refusal``, if it is another kind of vehicle's.
    """
    if isinstance(scenario, model):
        return scenario
    raise ValueError(refusal)


def load_any_scenario(name_or_path: str, settings: Sequence[str] = ()) -> AnyScenario:
    """Load a trailer's or a rover's scenario by name or file, and apply ``KEY=VALUE`` settings.

    Raises:
        ValueError: one line that names the scenario, the key, the value, its limit or the nearest known key.
    """
    table = _read(name_or_path)
    for setting in sorted(settings, key=_comes_first, reverse=True):
        _apply(table, setting)
    vehicle = table.get("vehicle")
    if isinstance(vehicle, str) and vehicle.endswith(".toml"):
        table["vehicle"] = full_path(vehicle)  # the resolved scenario runs again from any folder
    model = RoverScenario if table.get("kind") == RoverScenario.vehicle_kind else Scenario
    return _validated(_with_own_course(model, table), table, name_or_path)


def _with_own_course(model: type[AnyScenario], table: Table) -> type[AnyScenario]:
    """The model with the user's own kind of course, if ``course.kind`` is an import path."""
    course = table.get("course")
    kind = course.get("kind") if isinstance(course, dict) else None
    if not isinstance(kind, str) or ":" not in kind:
        return model
    part = resolve("course.kind", kind, Catalogue({}))
    base = CourseOptions if issubclass(model, Scenario) else RoverCourseOptions
    if not issubclass(part, base):
        raise ValueError(f"course.kind = {kind}: the class must be derived from {base.__module__}.{base.__name__}")
    return create_model(model.__name__, __base__=model, course=(part, ...))


def _read(name_or_path: str) -> Table:
    if name_or_path in scenario_names():
        return with_neighbours(shipped_table(name_or_path), FOLDER)
    if not name_or_path.endswith(".toml") and not os.path.isfile(name_or_path):
        raise ValueError(f"unknown scenario '{shown(name_or_path)}'{nearest(name_or_path, scenario_names())}")
    return with_neighbours(read_toml(Path(name_or_path), FileKind.SCENARIO), Path(name_or_path).parent)


def estimator_options(settings: Sequence[str], estimator: str) -> dict[str, Parameter]:
    """Options of an estimator from settings, by name: ``viso_ot.NAME=VALUE``, or ``estimator.NAME=VALUE`` of others.

    Raises:
        ValueError: one line, if a setting has another form.
    """
    table: Table = {}
    for setting in settings:
        _apply(table, setting)
    part = "viso_ot" if estimator == "viso_ot" else "estimator"
    for key, value in table.items():
        if key != part or not isinstance(value, dict):
            raise ValueError(f"--set {shown(key)}: expected {part}.NAME=VALUE, for example {part}.smoothing=true")
    options: dict[str, Parameter] = table.get(part, {})
    return options


def _comes_first(setting: str) -> bool:
    return setting.partition("=")[0].strip() == _COURSE_KIND  # it clears the keys of the kind before


def _apply(table: Table, setting: str) -> None:
    key, equals, text = setting.partition("=")
    parts = [part.strip() for part in key.split(".")]
    if not equals or not all(parts):
        example = "expected KEY=VALUE, for example --set surface.friction=0.3"
        raise ValueError(f"--set {shown(setting)}: {example}")
    if _CONTROL.search(setting) or len(parts) > MAX_NESTING or len(key) > _MAX_KEY:
        raise ValueError(
            f"--set {shown(setting)}: expected one KEY=VALUE without line breaks or control characters, with a key of "
            f"at most {_MAX_KEY} characters and {MAX_NESTING} parts"
        )
    *parents, last = parts
    for parent in parents:
        if parent in _NAMED and isinstance(table.get(parent), str):
            table[parent] = {"kind": table[parent]}
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise ValueError(f"--set {shown(setting)}: '{parent}' is a value, not a table")
    if parents == ["course"] and last == "kind" and table.get("kind") != text.strip():
        table.clear()  # the other keys belong to another kind of course
    table[last] = _value(text.strip())


def _value(text: str) -> Parameter | list[Any]:
    """A TOML value, or else the text itself: names need no quotes on a command line."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if point := _BARE_POINT.fullmatch(text):
        text = f"{point['sign']}{point['whole'] or 0}.{point['rest'] or 0}"
    try:
        value = parsed_toml(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float | str | list) else text


def _validated(model: type[AnyScenario], table: Table, source: str) -> AnyScenario:
    try:
        return model.model_validate(table)
    except ValidationError as error:
        known = tuple(_known_keys(model))
        raise ValueError(f"scenario {source}: {complaint(model, error, known=known)}") from None


def _known_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Dotted name of every key."""
    for name, field in model.model_fields.items():
        tables = tables_in(field.annotation)
        for table in tables:
            yield from _known_keys(table, f"{prefix}{name}.")
        if not tables:
            yield prefix + name


def stream(seed: int, name: str) -> np.random.Generator:
    """Random stream of a run by name; another consumer does not change it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()),)))
