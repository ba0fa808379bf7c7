"""Plants out as FMUs: one small truck, compiled without optimisation; more of them in ``tests/oracles``."""

from __future__ import annotations

import re
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi3 import fmi3IntermediateUpdateCallback
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

import offtrack
from offtrack.commands.cli import app
from offtrack.exchange.fmi_export import fmu_writer
from offtrack.exchange.fmi_export.fmu_writer import write_fmu
from offtrack.exchange.fmi_export.plant_kinds import combination_inputs, combination_model, plant_model, rover_model
from offtrack.exchange.fmi_export.plant_model import PlantModel, base_unit, common_files
from tests.fmus.hosts import host_here
from tests.fmus.plants import START, Slave, c_compiler, deviations, driven_here, driven_there, weave
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.rover.description import load_rover

pytestmark = pytest.mark.skipif(c_compiler() is None, reason="no C compiler")
TRUCK = "rigid_truck"


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle(TRUCK)


@pytest.fixture(scope="module")
def model(vehicle: Vehicle) -> PlantModel:
    return combination_model(vehicle)


@pytest.fixture(scope="module")
def fmus(model: PlantModel, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The truck in both versions, compiled by the system's compiler: the quickest."""
    folder = tmp_path_factory.mktemp("fmus")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu_writer, "_has_zig", lambda: False)
        for version in (2, 3):
            write_fmu(folder / f"{version}.fmu", model, version, ("linux64",), optimisation=0)
    return {version: folder / f"{version}.fmu" for version in (2, 3)}


def slave_of(fmus: dict[int, Path], version: int, values: dict[str, float] | None = None) -> Slave:
    return Slave(fmus[version], fmus[version].with_suffix(""), values)


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_finds_no_problem(fmus: dict[int, Path], version: int) -> None:
    assert validate_fmu(str(fmus[version])) == []


def test_a_weave_of_20_s_is_that_of_the_plant_here(fmus: dict[int, Path], vehicle: Vehicle) -> None:
    """The same equations, compiled with other flags: rounding grows by the sensitivity of the motion only."""
    drive = weave(20.0)
    slave = slave_of(fmus, 3, START)
    outputs = driven_there(slave, vehicle, drive)
    slave.close()
    found = deviations(driven_here(vehicle, drive), outputs)
    assert found.pop("wheel_load") < 1e-6  # N, of some 1e5
    assert max(found.values()) < 1e-9


def test_both_versions_compute_the_same_bits(fmus: dict[int, Path], vehicle: Vehicle) -> None:
    rows = []
    for version in (2, 3):
        slave = slave_of(fmus, version, START)
        rows.append(driven_there(slave, vehicle, weave(0.2)))
        slave.close()
    assert all(np.array_equal(rows[0][name], rows[1][name]) for name in rows[0])


@pytest.mark.parametrize("version", [2, 3])
def test_a_program_in_c_loads_and_steps_it(
    fmus: dict[int, Path], version: int, vehicle: Vehicle, tmp_path: Path
) -> None:
    """Bitwise as in FMPy, which calls the same library."""
    slave, drive = slave_of(fmus, version, START), weave(1.0)
    expected = driven_there(slave, vehicle, drive)
    names = slave.outputs
    slave.close()
    rows = {"steer": drive.steer, "acceleration": drive.acceleration}
    done = host_here(tmp_path).run(fmus[version], tmp_path / "x", rows=rows, outputs=names, starts=START)
    assert (done.returncode, done.stderr) == (0, "")
    found = np.loadtxt(done.stdout.splitlines())
    np.testing.assert_array_equal(found, np.column_stack([expected[name] for name in names]))


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_of_no_whole_ticks_is_refused_with_a_message(fmus: dict[int, Path], version: int) -> None:
    slave = slave_of(fmus, version)
    with pytest.raises(Exception, match="failed"):
        slave.step(0.0015)
    assert slave.messages[-1] == "communication step of 0.0015 s must be a whole number of ticks of 1 ms"
    slave.set({"gear": 0.5})
    with pytest.raises(Exception, match="failed"):
        slave.step()
    assert slave.messages[-1] == "gear = 0.5 must be 1 (forward) or -1 (backward)"
    with pytest.raises(Exception, match="failed"):
        slave.set({"units.0.mass": 9000.0})
    assert "fixed after the initialisation" in slave.messages[-1]
    slave.close()


@pytest.mark.parametrize("name", ["gear", "friction_wheel_1"])
def test_a_zero_of_what_is_never_zero_stands_for_the_start(fmus: dict[int, Path], name: str) -> None:
    """Importers such as FMPy's runner of systems begin with 0 on every connection."""
    slave = slave_of(fmus, 2, START)
    start = slave.get([name])
    slave.set({name: 0.0})
    slave.step()
    assert slave.get([name]) == start
    slave.close()


def test_a_parameter_is_that_number_of_the_vehicle_file(fmus: dict[int, Path], vehicle: Vehicle) -> None:
    """A heavier truck in the FMU drives as one whose file says so."""
    unit = vehicle.units[0]
    mass = unit.mass * 1.1
    heavier = vehicle.model_copy(update={"units": (unit.model_copy(update={"mass": mass}), *vehicle.units[1:])})
    drive = weave(1.0)
    slave = slave_of(fmus, 2, {**START, "units.0.mass": mass})
    found = deviations(driven_here(heavier, drive), driven_there(slave, vehicle, drive))
    slave.close()
    assert found["wheel_load"] < 1e-6
    assert found["y"] < 1e-9


@pytest.mark.parametrize("version", [2, 3])
def test_a_restored_state_goes_on_as_before(fmus: dict[int, Path], version: int) -> None:
    slave = slave_of(fmus, version, START)
    slave.set({"steer": 0.1})
    slave.step()
    fmu, kind = slave.fmu, "FMUstate" if version == 2 else "FMUState"
    state = getattr(fmu, f"get{kind}")()
    data = (fmu.serializeFMUstate if version == 2 else fmu.serializeFMUState)(state)
    first_time, ends = slave.time, []
    for _ in range(2):
        slave.time = first_time
        for _ in range(5):
            slave.step()
        ends.append(slave.get(slave.outputs))
        getattr(fmu, f"set{kind}")((fmu.deSerializeFMUstate if version == 2 else fmu.deserializeFMUState)(data))
    slave.close()
    assert ends[0] == ends[1]


def test_two_instances_in_two_threads_are_independent(fmus: dict[int, Path]) -> None:
    def end(steer: float, into: dict[float, list[float]]) -> None:
        slave = slave_of(fmus, 3, START)
        slave.set({"steer": steer})
        for _ in range(50):
            slave.step()
        into[steer] = slave.get(slave.outputs)
        slave.fmu.fmi3FreeInstance(slave.fmu.component)

    alone: dict[float, list[float]] = {}
    together: dict[float, list[float]] = {}
    for steer in (0.1, -0.2):
        end(steer, alone)
    threads = [threading.Thread(target=end, args=(steer, together)) for steer in (0.1, -0.2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert alone == together
    assert alone[0.1] != alone[-0.2]


def test_a_thousand_instances_leave_no_memory(fmus: dict[int, Path]) -> None:
    """Nor descriptors nor threads. An instance has some 10 kB: a thousand that stay would be 10 MB."""

    def usage() -> tuple[int, int, int]:
        status = Path("/proc/self/status").read_text()
        resident, threads = (int(re.findall(rf"{name}:\s+(\d+)", status)[0]) for name in ("VmRSS", "Threads"))
        return resident, threads, len(list(Path("/proc/self/fd").iterdir()))

    slave = slave_of(fmus, 3)
    fmu, token = slave.fmu, slave.description.instantiationToken.encode()
    no_update = fmi3IntermediateUpdateCallback(0)

    def cycle() -> None:
        one = fmu.fmi3InstantiateCoSimulation(
            b"x", token, None, False, False, False, False, None, 0, None, slave._log, no_update
        )
        assert one
        fmu.fmi3FreeInstance(one)

    for _ in range(100):
        cycle()
    before = usage()
    for _ in range(1000):
        cycle()
    after = usage()
    slave.close()
    assert after[0] - before[0] < 2000  # kB
    assert after[1:] == before[1:]


def test_every_unit_is_known(model: PlantModel) -> None:
    variables = model.interface.variables()
    assert all(one.signal.unit == "-" or base_unit(one.signal.unit) for one in variables)
    assert base_unit("rad/(m/s2)") == base_unit("rad s2/m")
    starts = {one.signal.name: one.signal for one in variables if one.signal.low is not None}
    assert all(one.low is not None and one.low <= one.start for one in starts.values())


def test_poses_follow_no_input_at_once_and_loads_follow_slopes(model: PlantModel, vehicle: Vehicle) -> None:
    variables = {one.signal.name: one for one in model.interface.variables()}
    assert variables["x_1"].feed_through == ()
    commands = {variables[name].reference for name in ("steer", "acceleration", "gear")}
    assert all(not commands & set(one.feed_through) for one in variables.values())
    assert variables["friction_wheel_1"].reference in variables["friction_used_1"].feed_through
    assert len(combination_inputs(vehicle)) == len(model.interface.inputs)


def test_what_is_fixed_stands_in_the_fmu(fmus: dict[int, Path]) -> None:
    with zipfile.ZipFile(fmus[2]) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "units.0.axles.0.steered" in page
    assert "units.0.width" in page  # no equation reads it


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nix"], "unknown vehicle or rover 'nix'"),
        ([TRUCK, "--fmi", "4"], "--fmi 4: must be 2 or 3"),
        ([TRUCK, "-o", "truck.zip"], "must end in .fmu"),
        ([TRUCK, "-o", "nowhere/truck.fmu"], "there is no folder nowhere"),
        ([TRUCK, "--platform", "amiga"], "must be one of linux64"),
        ([TRUCK, "--platform", "darwin-arm64", "--fmi", "2"], "FMI 2 has no name for it"),
        ([TRUCK, "--soil", "beach_sand"], "is no rover"),
        (["el_dorado_ii", "--wind"], "no inputs for the wind"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["fmu", "plant", *arguments])
    assert result.exit_code == 2
    assert reason in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_compiler_that_fails_leaves_no_file(
    model: PlantModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fmu_writer, "_FLAGS", ("--no-such-flag",))
    with pytest.raises(ValueError, match="the compiler failed") as error:
        write_fmu(tmp_path / "x.fmu", model, 3, ("linux64",))
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_no_function_of_fmi_3_is_forgotten_and_none_is_there_twice() -> None:
    """Importers look all of them up: those of the header are in the fixed file or in the one written at export."""
    files = common_files(3)
    declared = set(re.findall(r"FMI3_Export\s+fmi3\w+\s+(fmi3\w+);", files["fmi3Functions.h"]))
    written, fixed = (
        re.findall(r"^\w[\w ]*[ *](fmi3\w+)\(", files[name], re.MULTILINE) for name in ("fmi3_unused.c", "fmi3.c")
    )
    assert len(declared) > 70
    assert len(written) == len(set(written)) > 50
    assert not set(written) & set(fixed)
    assert declared == {*written, *fixed}


def test_every_axle_of_a_truck_has_inputs_for_torques(model: PlantModel, vehicle: Vehicle) -> None:
    """Of a drive and of a brake, besides the demand that the plant's own driveline shares out."""
    given = {one.name: one.unit for one in model.interface.inputs}
    axles = range(1, 1 + sum(len(unit.axles) for unit in vehicle.units))
    names = [f"{kind}_torque_{k}" for kind in ("drive", "brake") for k in axles]
    assert [name for name in given if "torque" in name] == names
    assert {given[name] for name in names} == {"N m"}


def test_only_a_truck_declares_a_fixed_internal_step(model: PlantModel) -> None:
    """A rover divides a communication step into equal ones of at most 5 ms, so that theirs depends on it."""
    assert model.internal_step == 1e-3
    rover = rover_model(load_rover("el_dorado_ii"), None)
    assert rover.internal_step is None
    assert "at most 5 ms" in rover.stepping


def test_a_rover_has_inputs_for_every_wheel() -> None:
    variables = plant_model("el_dorado_ii_skid", None, wind=False).interface.variables()
    names = [one.signal.name for one in variables]
    assert {"wheel_speed_demand_4", "ground_slope_x_4", "firm_4", "ground_height_4"} <= set(names)
    assert {"mass", "wheels.half_length", "start_psi"} <= set(names)
    assert len(names) == len(set(names))


@pytest.mark.slow
def test_our_own_fmu_in_a_run_drives_as_the_plant_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bank, with rough ground and another friction under the right wheels.

    The plant here looks the ground up anew every 0.1 m, the FMU gets it every 10 ms: hundredths of a millimetre.
    """
    file = tmp_path / "truck.fmu"
    monkeypatch.setattr(fmu_writer, "_has_zig", lambda: False)
    write_fmu(file, combination_model(load_vehicle("eu_tractor_semitrailer")), 2, ("linux64",), optimisation=0)
    settings = {
        "vehicle": "eu_tractor_semitrailer",
        "off_tracking": "truth",
        "trailer_steering": "none",
        "course.turn_deg": 30.0,
        "course.entry": 20.0,
        "course.exit": 5.0,
        "surface.cross_fall": 0.04,
        "surface.friction_right": 0.4,
        "surface.roughness": "C",
    }
    own = offtrack.run("roundabout", settings=settings)
    other = offtrack.run("roundabout", settings=settings | {"plant.fmu": str(file)})
    for name in ("x_tractor", "y_semitrailer", "psi_semitrailer", "off_tracking_true"):
        np.testing.assert_allclose(other[name], own[name], atol=1e-4)
