"""A scenario: everything that decides a run besides its seed, frozen and validated, from TOML and ``--set`` keys."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

Table = dict[str, Any]  # parsed TOML; nothing past this module sees one
Parameter = bool | int | float | str


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RoundaboutOptions(_Options):
    """The tractor's outer front corner on a circle, tangent entry and exit."""

    kind: Literal["roundabout"]
    direction: Literal["left", "right"] = "left"
    radius: float = Field(12.5, ge=11.0, le=100.0)  # of the outer front corner's circle [m]
    turn_deg: float = Field(360.0, ge=30.0, le=1800.0)
    entry: float = Field(30.0, ge=20.0, le=500.0)  # straight before the circle [m]
    exit: float = Field(35.0, ge=5.0, le=500.0)  # straight behind it [m]


class FigureOfEightOptions(_Options):
    """A full left circle, then a full right circle."""

    kind: Literal["figure-of-eight"]
    radius: float = Field(12.5, ge=11.0, le=100.0)  # of the outer front corner's circles [m]
    entry: float = Field(30.0, ge=20.0, le=500.0)  # [m]
    exit: float = Field(35.0, ge=5.0, le=500.0)  # [m]


class ConstantSlipOptions(_Options):
    """The trailer dragged along a straight line at a constant slip angle (de Saxe & Cebon 2018, section 3.1)."""

    kind: Literal["constant-slip"]
    slip_angle_deg: float = Field(14.0, ge=-60.0, le=60.0)  # direction of travel in the trailer frame, + left
    length: float = Field(100.0, ge=20.0, le=1000.0)  # [m]


Course = Annotated[RoundaboutOptions | FigureOfEightOptions | ConstantSlipOptions, Field(discriminator="kind")]


class SurfaceOptions(_Options):
    """The ground; see vehicle.surface."""

    friction: float = Field(0.8, ge=0.05, le=1.5)
    cross_fall: float = Field(0.0, ge=-0.2, le=0.2)  # a slope: 0.025 is 2.5 %
    grade: float = Field(0.0, ge=-0.2, le=0.2)


class RigOptions(_Options):
    """The stereo cameras on the trailer's roof (de Saxe & Cebon 2018, section 3.1)."""

    facing: Literal["rear", "left", "right"] = "rear"
    width: int = Field(1344, ge=320, le=4096)  # [px]
    height: int = Field(391, ge=200, le=4096)  # [px]
    hfov_deg: float = Field(100.0, ge=30.0, le=140.0)
    camera_height: float = Field(3.0, ge=0.5, le=6.0)  # above the ground [m]
    baseline: float = Field(0.5, ge=0.1, le=5.0)  # [m]
    rate_hz: float = Field(10.0, ge=1.0, le=50.0)
    latency: float = Field(0.1, ge=0.0, le=1.0)  # exposure to finished estimate [s]
    noise: float = Field(2.0, ge=0.0, le=50.0)  # standard deviation of the image noise [grey levels]


class WorldOptions(_Options):
    """What stands beside the road."""

    scenery_density: float = Field(1.0, ge=0.0, le=2.0)  # 1 is the reference, 0 bare ground


class Scenario(_Options):
    """One closed-loop run."""

    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9._-]+$")
    description: str = ""
    course: Course
    vehicle: str = "uk_longer_semitrailer"  # a known vehicle or a TOML file
    speed_kmh: float = Field(10.0, ge=1.0, le=120.0)
    trailer_steering: str = "path_preview"  # a known controller or package.module:Name
    steering: dict[str, Parameter] = {}  # its parameters; those not given keep their defaults
    off_tracking: str = "viso_ot"  # truth, viso_ot or package.module:Name
    odometry: str = "circular"  # a known odometry or package.module:Name
    surface: SurfaceOptions = SurfaceOptions()
    rig: RigOptions = RigOptions()
    world: WorldOptions = WorldOptions()

    @property
    def speed(self) -> float:
        """Set speed [m/s]."""
        return self.speed_kmh / 3.6

    def to_toml(self) -> str:
        """The resolved scenario as TOML: it runs again identically."""
        return tomli_w.dumps(self.model_dump())


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _data().iterdir() if file.name.endswith(".toml")))


def load_scenario(name_or_path: str, settings: Sequence[str] = ()) -> Scenario:
    """The scenario of that name or file, with ``KEY=VALUE`` settings applied.

    Raises:
        ValueError: one line that names the scenario, the key, the value, its limit or the nearest known key.
    """
    table = _read(name_or_path)
    for setting in settings:
        _apply(table, setting)
    return _validated(table, name_or_path)


def _data() -> resources.abc.Traversable:
    return resources.files("scenarios") / "data"


def _read(name_or_path: str) -> Table:
    if name_or_path in scenario_names():
        return tomllib.loads((_data() / f"{name_or_path}.toml").read_text(encoding="utf-8"))
    path = Path(name_or_path)
    if not path.is_file():
        if path.suffix == ".toml":
            raise ValueError(f"scenario file {name_or_path} does not exist")
        raise ValueError(f"unknown scenario '{name_or_path}'{nearest(name_or_path, scenario_names())}")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"scenario file {name_or_path} is not valid TOML: {error}") from error


def nearest(word: str, known: Sequence[str]) -> str:
    """The end of an error line for an unknown word: the nearest known one, or all of them."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean '{close[0]}'?" if close else f"; known: {', '.join(known)}"


def _apply(table: Table, setting: str) -> None:
    key, equals, text = setting.partition("=")
    if not equals or not key.strip():
        raise ValueError(f"--set {setting}: expected KEY=VALUE, for example --set surface.friction=0.3")
    *parents, last = key.strip().split(".")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise ValueError(f"--set {setting}: '{parent}' is a value, not a table")
    table[last] = _value(text.strip())


def _value(text: str) -> Parameter:
    """A TOML value, or the text itself where it is none: names need no quotes on a command line."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float | str) else text


def _validated(table: Table, source: str) -> Scenario:
    try:
        return Scenario.model_validate(table)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        kind = table.get("course", {}).get("kind") if isinstance(table.get("course"), Mapping) else None
        key = ".".join(str(part) for part in first["loc"] if part != kind)
        if first["type"] == "union_tag_invalid":
            tag, known = first["ctx"]["tag"], first["ctx"]["expected_tags"].replace("'", "")
            raise ValueError(f"scenario {source}: {key}.kind = '{tag}'; known: {known}") from None
        if first["type"] == "extra_forbidden":
            raise ValueError(f"scenario {source}: unknown key '{key}'{nearest(key, tuple(known_keys()))}") from None
        given = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise ValueError(f"scenario {source}: {key}{given}: {_lower_first(first['msg'])}") from None


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]


def known_keys(model: type[BaseModel] = Scenario, prefix: str = "") -> Iterator[str]:
    """Dotted names of every key a scenario may have."""
    for name, info in model.model_fields.items():
        tables = [part for part in _alternatives(info.annotation) if isinstance(part, type) and issubclass(part, BaseModel)]
        if not tables:
            yield prefix + name
        for nested in tables:
            yield from known_keys(nested, f"{prefix}{name}.")


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    return getattr(annotation, "__args__", ()) or (annotation,)
