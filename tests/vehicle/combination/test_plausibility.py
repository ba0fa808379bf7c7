"""Unlikely and impossible vehicle files: refused with the reason of the limit, or warned of by name."""

from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_from
from vehicle.combination.variants import number_paths
from vehicle.tyres.laws import TYRES

TRACTOR, TRAILER = "units.0 (tractor)", "units.1 (semitrailer)"


def changed(vehicle: Vehicle, changes: dict[str, Any]) -> Vehicle:
    """The vehicle with other contents of its file, by dotted path with indices."""
    contents = vehicle.model_dump()
    for path, value in changes.items():
        *tables, key = path.split(".")
        table: Any = contents
        for name in tables:
            table = table[int(name)] if name.isdigit() else table[name]
        table[key] = value
    for unit in contents["units"]:
        del unit["lifted_axles"]
    return vehicle_from(contents, "mine.toml")


def numbers(model: type[BaseModel], place: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every quantity of a model and of those inside it: its place, and what its schema says about it."""
    for name, field in model.model_fields.items():
        notes = [field.json_schema_extra]
        for part in _parts(field.annotation):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from numbers(part, f"{place}{name}.")
            notes += [getattr(entry, "json_schema_extra", None) for entry in getattr(part, "__metadata__", ())]
        of_number = [note for note in notes if isinstance(note, dict) and "unit" in note]
        if of_number:
            yield f"{place}{name}", of_number[0]


def _parts(annotation: Any) -> Iterator[Any]:
    yield annotation
    for part in getattr(annotation, "__args__", ()):
        yield from _parts(part)


@pytest.mark.parametrize("model", [Vehicle, *TYRES.values()], ids=lambda model: model.__name__)
def test_every_number_says_why_it_has_limits(model: type[BaseModel]) -> None:
    silent = [place for place, note in numbers(model) if not note.get("why")]
    assert silent == []
    assert len(list(numbers(model))) > 4


WARNED = [
    ({"units.1.axles.2.x": -12.5}, "units.1.axles.2 (semitrailer): at x = -12.5 m it lies outside the unit"),
    ({"units.0.axles.0.x": 5.5}, "units.0.axles.0 (tractor): at x = 5.5 m it lies outside the unit"),
    ({"units.0.axles.1.track": 2.6}, "units.0.axles.1 (tractor): track = 2.6 m: its wheels stick out"),
    ({"units.0.cg_x": 4.0}, f"{TRACTOR}: its centre of gravity at cg_x = 4 m does not lie between first and last axle"),
    ({"units.1.cg_x": -9.5}, f"{TRAILER}: its centre of gravity at cg_x = -9.5 m does not lie between hitch and last"),
    ({"units.1.cg_x": -13.0}, f"{TRAILER}: its centre of gravity at cg_x = -13 m lies outside"),
    ({"units.1.cg_height": 4.2}, f"{TRAILER}: its centre of gravity at cg_height = 4.2 m lies above its top, 4 m"),
    ({"units.1.cg_height": 0.6}, f"{TRAILER}: roll_axis_height = 0.7 m is not below cg_height = 0.6 m"),
    ({"units.0.hitch_x": 5.5}, f"{TRACTOR}: its rear hitch at x = 5.5 m lies ahead of it"),
    ({"units.1.follow_x": -14.0}, f"{TRAILER}: its follow point at x = -14 m lies behind it"),
    ({"units.1.yaw_inertia": 3e6}, f"{TRAILER}: yaw_inertia = 3e+06 kg m2 is a radius of gyration of 9.68 m"),
    ({"units.1.yaw_inertia": 450.0}, f"{TRAILER}: yaw_inertia = 450 kg m2 is a radius of gyration of 0.12 m"),
    ({"units.1.roll.inertia": 4e5}, f"{TRAILER}: roll.inertia = 400000 kg m2 is a radius of gyration of 3.54 m"),
    ({"units.1.pitch_gradient": 0.03}, f"{TRAILER}: pitch_gradient = 0.03 rad/(m/s2) and pitch_frequency = 1.5 Hz"),
    ({"units.0.axles.0.ackermann_x": 3.2}, "units.0.axles.0 (tractor): ackermann_x = 3.2 m is so near to the axle"),
    (
        {"units.0.axles.0.wheel_inertia": 0.1},
        "units.0.axles.0 (tractor): wheel_inertia = 0.1 kg m2 is a wheel of 0.816",
    ),
    ({"units.1.payload.mass": 33e3}, f"{TRAILER}: payload.mass = 33000 kg leaves nothing of its mass of 32000 kg"),
    ({"units.1.payload.cg_height": 3.5}, f"{TRAILER}: its payload reaches 4.55 m high, above its top at 4 m"),
    ({"units.1.payload.width": 3.0}, f"{TRAILER}: payload.width = 3 m is more than its own, 2.55 m"),
    ({"units.1.mass": 120e3}, "units.0.axles.1 (tractor): carries 34.4 t, more than the 16 t of four truck tyres"),
    ({"units.1.cg_x": -8.5}, f"{TRAILER}: its front hitch pulls up with 32.6 kN"),
    ({"units.1.cg_x": 0.5}, "units.1.axles.0 (semitrailer): carries -6.8 kN, it must be above 0 kN"),
    ({"units.1.cg_x": -0.5}, "units.0.axles.1 (tractor): 2.4 times its tyres' nominal load"),  # 26.86 t, by moments
    (
        {"units.1.axles.2.load_share": 0.3},
        "units.1.axles.2 (semitrailer): it carries 3.0 t and its neighbour ahead 9.9 t: with load_share 0.3 and 1 the",
    ),
]


@pytest.mark.parametrize(("changes", "says"), WARNED)
def test_contradictions_are_warned_of_by_name(tractor_semitrailer: Vehicle, changes: dict[str, Any], says: str) -> None:
    sheet = data_sheet(changed(tractor_semitrailer, changes))
    assert any(line.startswith(says) for line in sheet.warnings), sheet.warnings
    assert sheet.stands == all("must be above 0 kN" not in line for line in sheet.warnings)


def test_a_tandem_without_a_suspension_that_equalises_is_warned_of() -> None:
    """A load behind it bears on the nearer axle of two on springs of their own; in a bogie both carry the same."""
    vehicle = load_vehicle("rigid_truck_8x4")
    assert data_sheet(vehicle).warnings == ()
    alone = changed(vehicle, {"units.0.axles.2.bogie": None, "units.0.axles.3.bogie": None, "units.0.cg_x": 1.2})
    (line,) = data_sheet(alone).warnings
    assert line.startswith("units.0.axles.3 (truck): it carries ")
    assert "only 1.35 m apart: name a bogie for both" in line


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"units.1.roll_frequency": 4.0}, "roll_gradient = 0.0089 rad/(m/s2) and roll_frequency = 4 Hz contradict"),
        ({"units.1.roll_gradient": 0.0005}, "roll_gradient = 0.0005 rad/(m/s2) and roll_frequency = 1.2 Hz"),
    ],
)
def test_a_gradient_and_a_frequency_that_contradict_are_warned_of(
    short_form: Vehicle, changes: dict[str, Any], says: str
) -> None:
    assert f"{TRAILER}: {says}" in " ".join(data_sheet(changed(short_form, changes)).warnings)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_wrong_unit_of_any_number_is_refused_or_warned_of(tractor_semitrailer: Vehicle, factor: float) -> None:
    """A thousand times too small or large: kN for N, mm for m, t for kg; but for numbers that may be small or large."""
    harmless = {
        *("lag", "rate_limit_deg", "limit_deg", "damping", "suspension_damping", "hitch_roll_share", "load_share"),
        *("load_sensitivity", "rolling_resistance", "pneumatic_trail", "curvature", "relaxation_length", "rear_x"),
        *("steer_ratio", "hitch_x", "ackermann_x", "lash_deg", "max_acceleration", "max_deceleration", "follow_x"),
        "roll_axis_height",
    }
    silent = []
    for path, value in number_paths(tractor_semitrailer).items():
        name = path.rpartition(".")[2]
        plain = path.split(".")[0] in ("units", "drive") and ".tyre." not in path and not path.startswith("units.t")
        if not (plain and isinstance(value, float) and value) or name in harmless or path.startswith("units.sem"):
            continue
        # near the unit's origin as well, and places that a short drawbar trailer has
        if path.endswith("side_wind.x") or (path.startswith("units.1.") and name in ("front_x", "x")):
            continue
        try:
            warnings = data_sheet(changed(tractor_semitrailer, {path: factor * value})).warnings
        except ValueError:
            continue
        if not warnings:
            silent.append(path)
    assert silent == []
