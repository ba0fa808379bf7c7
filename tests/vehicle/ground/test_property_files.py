"""Tyre property files: forces and moments are those of the published equations, and wrong ones are refused by place."""

import itertools
import math
import os
import re
import tomllib
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.results.run_inputs import run_inputs, tyre_files, write_inputs
from tests.vehicle.ground.published_magic_formula import published
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.linear import straight_running
from vehicle.combination.variants import changed_vehicle, number_paths
from vehicle.tyres import Planar
from vehicle.tyres.magic_formula import PropertyFileTyre
from vehicle.tyres.property_file import tyre_of_file

FILES = Path(__file__).parent / "tyre_files"
TEXT = {name: (FILES / f"truck_{name}.tir").read_text() for name in ("52", "61")}
WHERE = list(itertools.product([5e3, 35e3, 6e4], [-0.9, -0.05, 0.0, 0.003, 0.1], [-0.4, -0.05, 0.0, 0.02, 0.2]))


def with_(text: str, **values: Any) -> str:
    """The text with other values of its keys, or without those whose value is None."""
    for key, value in values.items():
        new = "" if value is None else f"{key} = {value}"
        text, count = re.subn(rf"^{key}\s*=.*$", new, text, flags=re.M)
        if not count:
            text += f"\n{new}"
    return text


@pytest.fixture
def tyre(tmp_path: Path) -> Callable[..., PropertyFileTyre]:
    def read(text: str, **options: Any) -> PropertyFileTyre:
        (tmp_path / "x.tir").write_text(text)
        table = {"model": "magic_formula", "file": "x.tir", **options}
        return tyre_of_file(table, str(tmp_path / "truck.toml"), "tyres.x")

    return read


def acting(tyre: PropertyFileTyre, F_z: float, kappa: float, alpha: float, friction: float = 0.8) -> tuple[float, ...]:
    """Steady force along and to the left [N], and moment to the left [N m]."""
    F = tyre.steady_force(Planar(kappa, -math.tan(alpha)), F_z, friction)
    grip = tyre.grip(F_z, friction, tyre.sliding_rate(kappa, math.tan(alpha)), 1.0)
    return float(F.x), float(F.y), float(grip.moment - grip.trail * F.y)


def numbers(text: str) -> dict[str, float]:
    return {key: float(value) for key, value in re.findall(r"^(\w+)\s*=\s*([-+.\deE]+)\s*$", text, re.M)}


@pytest.mark.parametrize("camber", [-0.1, 0.0, 0.05])
@pytest.mark.parametrize(("name", "fittyp"), [("52", 6), ("52", 52), ("61", 61), ("61", 62)])
def test_combined_forces_and_moments_are_the_published_ones(tyre: Any, name: str, fittyp: int, camber: float) -> None:
    """On three grounds, within 0.1 % of the friction (moments: at a lever of 1 % of the radius)."""
    text = with_(TEXT[name], FITTYP=fittyp, LMUV=0)
    got_of, c = tyre(text).on_wheel(+1, camber), numbers(text)
    for (F_z, kappa, alpha), mu in itertools.product(WHERE, (0.3, 0.8, 1.0)):
        expected = published(c, F_z, kappa, alpha, camber, mu, is_52=name == "52")
        got = acting(got_of, F_z, kappa, alpha, mu)
        assert got[:2] == pytest.approx(expected[:2], abs=1e-3 * mu * F_z)
        assert got[2] == pytest.approx(expected[2], abs=1e-3 * mu * F_z * 0.01)


def test_the_relaxation_lengths_are_those_of_the_file(tyre: Any) -> None:
    """5.2: PTX and PTY with the load; 6.1: slip stiffness over the carcass's; the lag of small slip is that length."""
    old, new = tyre(TEXT["52"]), tyre(TEXT["61"])
    c = numbers(TEXT["52"])
    for F_z in (2e4, 35e3, 5e4):
        dfz = F_z / 35e3 - 1.0
        across = c["PTY1"] * math.sin(2.0 * math.atan(F_z / (c["PTY2"] * 35e3))) * 0.52
        along = F_z * (c["PTX1"] + c["PTX2"] * dfz) * math.exp(c["PTX3"] * dfz) * 0.52 / 35e3
        for tyre_, expected in (
            (old, (along, across)),
            (new, (new.stiffness(F_z).x * F_z / 9e5, new.stiffness(F_z).y * F_z / 4.2e5)),
        ):
            decays = tyre_.grip(F_z, 0.8, tyre_.sliding_rate(0.0, 1e-5), 10.0).decays
            assert 10.0 / np.array(decays) == pytest.approx(expected, rel=1e-3)
    constant = tyre(TEXT["61"], relaxation_length=0.4)
    assert 10.0 / np.array(constant.grip(2e4, 0.8, Planar(0.0, 1e-6), 10.0).decays) == pytest.approx(
        (0.4, 0.4), rel=1e-3
    )


UNITS = {
    "mm, kN, degree": {"LENGTH": ("'mm'", 1e-3), "FORCE": ("'kN'", 1e3), "ANGLE": ("'degrees'", math.pi / 180.0)},
    "inch, lbf": {"LENGTH": ("'inch'", 0.0254), "FORCE": ("'pound_force'", 4.4482216152605)},
    "milliseconds": {"TIME": ("'millisecond'", 1e-3)},
}


@pytest.mark.parametrize("units", UNITS)
def test_the_same_tyre_in_other_units_is_the_same(tyre: Any, units: str) -> None:
    """Loads, lengths, speeds, pressures, stiffnesses and angles of ranges have them; coefficients have none."""
    factor = {"LENGTH": 1.0, "FORCE": 1.0, "ANGLE": 1.0, "TIME": 1.0} | {k: f for k, (_, f) in UNITS[units].items()}
    L, F, A, T = (factor[name] for name in ("LENGTH", "FORCE", "ANGLE", "TIME"))
    unit = {"FNOMIN": F, "FZMIN": F, "FZMAX": F, "UNLOADED_RADIUS": L, "LONGVL": L / T, "ALPMIN": A, "ALPMAX": A}
    unit |= {"CAMMIN": A, "CAMMAX": A, "INFLPRES": F / L**2, "NOMPRES": F / L**2}
    unit |= {"LONGITUDINAL_STIFFNESS": F / L, "LATERAL_STIFFNESS": F / L}
    text = with_(TEXT["61"], LMUV=0.01)
    there = {key: repr(value / unit[key]) for key, value in numbers(text).items() if key in unit}
    other = tyre(with_(text, **there, **{key: word for key, (word, _) in UNITS[units].items()}))
    assert other.nominal_load == pytest.approx(35e3)
    for F_z, kappa, alpha in WHERE:
        assert acting(other.on_wheel(1, 0.05), F_z, kappa, alpha) == pytest.approx(
            acting(tyre(text).on_wheel(1, 0.05), F_z, kappa, alpha), rel=1e-9, abs=1e-6
        )


@pytest.mark.parametrize("name", ["52", "61"])
def test_on_the_other_side_a_tyre_is_its_mirror_image(tyre: Any, name: str) -> None:
    """By its side in the file, by USE_MODE below 0; a symmetric one is its own, and has no force without slip."""
    left, right = tyre(TEXT[name]), tyre(with_(TEXT[name], TYRESIDE="'Right'"))
    mirrored, symmetric = tyre(with_(TEXT[name], USE_MODE=-14)), tyre(with_(TEXT[name], TYRESIDE="'SYMMETRIC'"))
    assert acting(left.on_wheel(1, 0.0), 35e3, 0.0, 0.0)[1] != pytest.approx(0.0, abs=10.0)
    assert acting(symmetric.on_wheel(1, 0.0), 35e3, 0.0, 0.0)[1:] == pytest.approx((0.0, 0.0), abs=1e-3)
    for F_z, kappa, alpha in WHERE:
        F_x, F_y, M_z = acting(left.on_wheel(1, 0.05), F_z, kappa, alpha)
        same = pytest.approx((F_x, -F_y, -M_z), rel=1e-9, abs=1e-6)
        assert acting(left.on_wheel(-1, -0.05), F_z, kappa, -alpha) == same
        assert acting(right.on_wheel(1, -0.05), F_z, kappa, -alpha) == same
        assert acting(mirrored.on_wheel(1, -0.05), F_z, kappa, -alpha) == same
        F_x, F_y, M_z = acting(symmetric.on_wheel(1, 0.05), F_z, kappa, alpha)
        assert acting(symmetric.on_wheel(1, -0.05), F_z, kappa, -alpha) == pytest.approx((F_x, -F_y, -M_z), abs=1e-3)


def test_a_file_in_the_axes_of_the_book_is_the_same_tyre(tyre: Any) -> None:
    """With y to the right PKY1 is above 0, and so turn all terms that are a force or moment by themselves."""
    turned = [f"{kind}{k}" for kind, count in (("PVY", 4), ("RVY", 3)) for k in range(1, count + 1)]
    turned += [
        "PKY1",
        "PKY6",
        "PKY7",
        "QDZ6",
        "QDZ7",
        "QDZ8",
        "QDZ9",
        "QDZ10",
        "QDZ11",
        "QBZ10",
        "SSZ1",
        "SSZ3",
        "SSZ4",
    ]
    c = numbers(TEXT["61"])
    book = tyre(with_(TEXT["61"], **{name: -c[name] for name in turned}))
    for F_z, kappa, alpha in WHERE:
        got, expected = (acting(one.on_wheel(1, 0.05), F_z, kappa, alpha) for one in (book, tyre(TEXT["61"])))
        assert got == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_scaling_friction_pressure_and_twins(tyre: Any) -> None:
    """LMUY and the ground's friction scale the peak alike; two tyres carry twice the load with twice the force."""
    one, grippy = tyre(TEXT["61"]), tyre(with_(TEXT["61"], LMUY=2 * 0.97))
    assert acting(one, 35e3, 0.0, 0.6, 0.8)[1] == pytest.approx(acting(grippy, 35e3, 0.0, 0.6, 0.4)[1], rel=1e-6)
    measured = tyre(TEXT["61"], reference_friction=0.8)
    assert acting(measured, 35e3, 0.02, 0.1, 0.4)[:2] == pytest.approx(acting(one, 35e3, 0.02, 0.1, 0.5)[:2], rel=1e-9)
    twin = tyre(TEXT["61"], tyres_per_wheel=2).on_wheel(1, 0.02)
    expected = 2.0 * np.array(acting(one.on_wheel(1, 0.02), 3e4, 0.02, 0.05))
    assert acting(twin, 6e4, 0.02, 0.05) == pytest.approx(tuple(expected), rel=1e-9)
    assert twin.relaxation_length == pytest.approx(one.relaxation_length)
    soft = tyre(TEXT["61"], pressure=7e5)
    c = numbers(with_(TEXT["61"], INFLPRES=7e5))
    F_y = published(c, 35e3, 0.0, 0.05, 0.0, 0.8, is_52=False).F_y
    assert acting(soft.on_wheel(1, 0.0), 35e3, 0.0, 0.05)[1] == pytest.approx(F_y, rel=1e-6)
    assert one.with_cornering_scaled(1.2)["coefficients"]["LKY"] == pytest.approx(1.2 * 1.05)


def test_without_combined_slip_each_direction_is_by_itself(tyre: Any) -> None:
    """USE_MODE 3, which needs no coefficients of combined slip."""
    alone = tyre(with_(TEXT["61"], USE_MODE=13, RBX1=None, RCX1=None, RBY1=None, RCY1=None)).on_wheel(1, 0.0)
    both, along = acting(alone, 35e3, 0.1, 0.1), acting(alone, 35e3, 0.1, 0.0)
    across = acting(alone, 35e3, 0.0, 0.1)
    assert both[:2] == pytest.approx((along[0], across[1]), rel=1e-9)
    assert math.hypot(*both[:2]) > 1.2 * max(abs(both[0]), abs(both[1]))


def test_beyond_its_ranges_a_tyre_is_as_at_their_ends(tyre: Any) -> None:
    """Slip and camber count as the limit, load keeps force over load; a vehicle whose loads are beyond is warned of."""
    narrow = with_(TEXT["61"], ALPMIN=-0.1, ALPMAX=0.1, KPUMIN=-0.2, KPUMAX=0.2, CAMMIN=-0.02, CAMMAX=0.02, FZMAX=5e4)
    got = tyre(narrow)
    inside, beyond = (
        acting(got.on_wheel(1, g), F, k, a)[:2] for g, F, k, a in ((0.02, 5e4, 0.2, 0.1), (0.1, 6e4, 0.5, 0.3))
    )
    assert beyond == pytest.approx(tuple(1.2 * force for force in inside), rel=1e-6)


def on_files(tmp_path: Path, text: str, options: str = "") -> Vehicle:
    """The European combination on tyres of a file, a twin on the driven axle."""
    (tmp_path / "x.tir").write_text(text)
    source = (
        Path(load_vehicle.__globals__["__file__"]).parents[1] / "parameters/eu_tractor_semitrailer.toml"
    ).read_text()

    def table(match: re.Match[str]) -> str:
        twin = ", tyres_per_wheel = 2" if match[1] == "drive" else ""
        return f'tyre = {{law = "magic_formula", file = "x.tir"{twin}{options}}}'

    (tmp_path / "truck.toml").write_text(re.sub(r'tyre = "(\w+)"', table, source))
    return load_vehicle(str(tmp_path / "truck.toml"))


@pytest.mark.parametrize("name", ["52", "61"])
def test_a_vehicle_on_such_tyres_runs_straight(tmp_path: Path, name: str) -> None:
    """Left and right are mirror images, so the offsets cancel; its numbers have paths, and changes reach the law."""
    vehicle = on_files(tmp_path, TEXT[name])
    assert not [line for line in data_sheet(vehicle).warnings if "tyre data" in line]
    x, _ = straight_running(vehicle, 20.0, 0.8)
    assert np.isfinite(x).all()
    softer = changed_vehicle(vehicle, {"units.1.axles.0.tyre.coefficients.LKY": 0.5})
    assert softer.units[1].axles[0].tyre.stiffness(35e3).y < 0.6 * vehicle.units[1].axles[0].tyre.stiffness(35e3).y
    assert number_paths(vehicle)["units.0.axles.0.tyre.coefficients.PCY1"] == 1.35
    overloaded = data_sheet(on_files(tmp_path, with_(TEXT[name], FZMAX=35e3)))
    assert any(
        "units.0.axles.1" in line or "semitrailer" in line for line in overloaded.warnings if "tyre data" in line
    )


BROKEN = {
    "no tir": ("hello = 1\n", "x.tir: is no tyre property file"),
    "binary": ("\0\1\2", "x.tir: is no tyre property file"),
    "another type": (with_(TEXT["61"], FILE_TYPE="'rdf'"), "is no tyre property file"),
    "another model": (with_(TEXT["61"], FITTYP=21), "line 14, [MODEL]: FITTYP = 21 is another tyre model"),
    "a format": (with_(TEXT["61"], FITTYP=None, PROPERTY_FILE_FORMAT="'FTIRE'"), "FORMAT = FTIRE is another"),
    "no model": (with_(TEXT["61"], FITTYP=None), "[MODEL]: FITTYP is missing"),
    "no coefficient": (with_(TEXT["61"], PKY1=None), "[LATERAL_COEFFICIENTS]: PKY1 is missing"),
    "no combined slip": (with_(TEXT["61"], RBX1=None), "[LONGITUDINAL_COEFFICIENTS]: RBX1 is missing"),
    "no load": (with_(TEXT["61"], FNOMIN=None), "[VERTICAL]: FNOMIN is missing"),
    "zero load": (with_(TEXT["61"], FNOMIN=0), "[VERTICAL]: FNOMIN = 0 is 0 N and must be between 300"),
    "unit": (with_(TEXT["61"], FORCE="'stone'"), "line 9, [UNITS]: FORCE = 'stone' is no unit"),
    "a word": (with_(TEXT["61"], PDY1="much"), "[LATERAL_COEFFICIENTS]: PDY1 = much must be a finite number"),
    "infinite": (with_(TEXT["61"], PDY1="1e999"), "PDY1 = 1e999 must be a finite number"),
    "no stiffness": (with_(TEXT["61"], PKX1=0), "PKX1 = 0 must be above 0"),
    "no side stiffness": (with_(TEXT["61"], PKY1=0), "PKY1 = 0 must not be 0"),
    "shape": (with_(TEXT["61"], PCX1=2.4), "PCX1 = 2.4 with its scaling factor must be above 0 and at most 2"),
    "side": (with_(TEXT["61"], TYRESIDE="'front'"), "[MODEL]: TYRESIDE = front must be LEFT, RIGHT or SYMMETRIC"),
    "mode": (with_(TEXT["61"], USE_MODE=1), "[MODEL]: USE_MODE = 1 gives no forces in both directions"),
    "range": (with_(TEXT["61"], KPUMAX=-2), "[LONG_SLIP_RANGE]: KPUMAX = -2 leaves a range of -1.5 to -2"),
    "loads": (with_(TEXT["61"], FZMIN=4e4), "[VERTICAL_FORCE_RANGE]: FZMIN = 40000.0 leaves a range"),
    "pressure": (with_(TEXT["61"], PRESMIN=8.6e5), "x.tir: pressure = 850000.0 Pa must be at least 860000 Pa"),
    "no relaxation": (with_(TEXT["61"], LATERAL_STIFFNESS=None), "give relaxation_length [m] beside the file"),
    "no rolling": (with_(TEXT["61"], QSY1=None), "[ROLLING_COEFFICIENTS]: QSY1 is missing"),
    "twice": (TEXT["61"] + "\nPHY1 = 1\n[LATERAL_COEFFICIENTS]\nPCY1=1\nPCY1 = 2\n", "PCY1 stands in line"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_wrong_file_is_refused_in_one_line_with_its_place(tmp_path: Path, kind: str) -> None:
    text, says = BROKEN[kind]
    with pytest.raises(ValueError, match=re.escape(says)) as refusal:
        on_files(tmp_path, text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"file": "y.tir"}, "y.tir: cannot be read"),
        ({"model": "brush"}, "a file of a tyre needs law = \"magic_formula\", not 'brush'"),
        ({"pressure": 8.0}, "tyres.x.pressure = 8.0 Pa must be between 10000"),
        ({"tyres_per_wheel": 4}, "tyres.x.tyres_per_wheel = 4 must be between 1 and 2"),
        ({"side": "left"}, "unknown key 'tyres.x.side'"),
    ],
)
def test_wrong_words_beside_a_file_are_refused(tyre: Any, table: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        tyre(TEXT["61"], **table)


def test_tyre_files_are_not_looked_for_in_a_file_too_large_for_a_vehicle(tmp_path: Path) -> None:
    (tmp_path / "x.toml").touch()
    os.truncate(tmp_path / "x.toml", 100_000_000)
    tracemalloc.start()
    assert tyre_files(str(tmp_path / "x.toml")) == {}
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()


def test_a_run_directory_takes_the_tyre_files_of_its_vehicle_along(tmp_path: Path) -> None:
    """From a folder beside the vehicle's; the copies work without the files that they are of."""
    vehicle = on_files(tmp_path, TEXT["61"])
    (tmp_path / "tyres").mkdir()
    (tmp_path / "x.tir").rename(tmp_path / "tyres" / "x.tir")
    file, run = tmp_path / "truck.toml", tmp_path / "run"
    file.write_text(file.read_text().replace('"x.tir"', '"tyres/x.tir"'))
    inputs = run_inputs({"vehicle": str(file)})
    for gone in (file, tmp_path / "tyres" / "x.tir"):
        gone.unlink()
    run.mkdir()
    scenario = write_inputs(f'vehicle = "{file}"\n', inputs, run)
    assert load_vehicle(str(run / tomllib.loads(scenario)["vehicle"])) == vehicle
