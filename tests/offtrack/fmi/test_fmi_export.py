"""Plants out as FMUs: one small truck, compiled without optimisation; more of them in ``tests/oracles``."""

import re
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from offtrack.exchange.fmi_export import fmu_writer
from offtrack.exchange.fmi_export.fmu_writer import write_fmu
from offtrack.exchange.fmi_export.plant_kinds import combination_inputs, combination_model, plant_model
from offtrack.exchange.fmi_export.plant_model import PlantModel, base_unit, common_files
from tests.fmus.hosts import host_here
from tests.fmus.plants import START, Slave, c_compiler, deviations, driven_here, driven_there, weave
from tests.soak.measure import soaked, usage
from vehicle.combination.description import Vehicle, load_vehicle

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
def test_wrong_steps_and_values_are_refused_with_a_message(fmus: dict[int, Path], version: int) -> None:
    """But for a zero of what is never zero, with which importers such as FMPy's runner begin on every connection."""
    slave = slave_of(fmus, version)
    with pytest.raises(Exception, match="failed"):
        slave.step(-0.001)
    assert slave.messages[-1] == "communication step of -0.001 s must be above 0, at most 1e+06 s"
    slave.set({"gear": 0.5})
    with pytest.raises(Exception, match="failed"):
        slave.step()
    assert slave.messages[-1] == "gear = 0.5 must be 1 (forward) or -1 (backward)"
    with pytest.raises(Exception, match="failed"):
        slave.set({"units.0.mass": 9000.0})
    assert "fixed after the initialisation" in slave.messages[-1]
    slave.close()
    slave, names = slave_of(fmus, version), ["gear", "friction_wheel_1"]
    start = slave.get(names)
    slave.set(dict.fromkeys(names, 0.0))
    slave.step()
    assert slave.get(names) == start
    slave.close()


@pytest.mark.parametrize("version", [2, 3])
def test_a_host_of_60_hz_gets_the_motion_of_one_of_100_hz(fmus: dict[int, Path], version: int) -> None:
    """Its steps of 16.7 ms are 17 equal ones inside: the integrator's error is of the order of 1 ms of a bend."""
    ends = []
    for rate, steps in ((100, 300), (60, 180)):
        slave = slave_of(fmus, version, START)
        slave.set({"steer": 0.1})
        for _ in range(steps):
            slave.step(1.0 / rate)
        assert slave.time == pytest.approx(3.0, abs=1e-6)
        ends.append(slave.get(["x_1", "y_1", "psi_1", "yaw_rate_1"]))
        slave.close()
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.0, atol=1e-4)


def test_a_truck_weaves_as_one_here_with_the_same_numbers(fmus: dict[int, Path], vehicle: Vehicle) -> None:
    """The same equations, compiled with other flags; a parameter is that number of the vehicle file."""
    unit, drive = vehicle.units[0], weave(5.0)
    mass = unit.mass * 1.1
    here = vehicle.model_copy(update={"units": (unit.model_copy(update={"mass": mass}), *vehicle.units[1:])})
    slave = slave_of(fmus, 2, {**START, "units.0.mass": mass})
    found = deviations(driven_here(here, drive), driven_there(slave, vehicle, drive))
    slave.close()
    assert found.pop("wheel_load") < 1e-6  # N, of some 1e5
    assert max(found.values()) < 1e-9


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
    def end(steer: float) -> list[float]:
        slave = slave_of(fmus, 3, START)
        slave.set({"steer": steer})
        for _ in range(50):
            slave.step()
        ended = slave.get(slave.outputs)
        slave.fmu.fmi3FreeInstance(slave.fmu.component)
        return ended

    alone = [end(steer) for steer in (0.1, -0.2)]
    with ThreadPoolExecutor(2) as pool:
        assert [*pool.map(end, (0.1, -0.2))] == alone
    assert alone[0] != alone[1]


def test_a_thousand_instances_leave_nothing(fmus: dict[int, Path]) -> None:
    """An instance has some 10 kB: a thousand that stay would be 10 MB; half of the cycles warm up."""
    slave = slave_of(fmus, 3)
    assert soaked(lambda: slave.again(fmus[3].with_suffix("")), usage(), 2000).wrong(0.0) is None
    slave.close()


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


def test_trucks_and_rovers_have_their_own_interfaces(model: PlantModel, vehicle: Vehicle) -> None:
    """Torques of a drive and of a brake at every axle of a truck, besides the demand to its own driveline.

    A rover divides a communication step into equal ones of at most 5 ms, so that theirs depends on it.
    """
    given = {one.name: one.unit for one in model.interface.inputs}
    axles = range(1, 1 + sum(len(unit.axles) for unit in vehicle.units))
    torques = [f"{kind}_torque_{k}" for kind in ("drive", "brake") for k in axles]
    assert [name for name in given if "torque" in name] == torques
    assert {given[name] for name in torques} == {"N m"}
    rover = plant_model("el_dorado_ii_skid", None, wind=False)
    names = [one.signal.name for one in rover.interface.variables()]
    assert {"wheel_speed_demand_4", "ground_slope_x_4", "firm_4", "ground_height_4"} <= set(names)
    assert {"mass", "wheels.half_length", "start_psi"} <= set(names)
    assert len(names) == len(set(names))
    assert "at most 1 ms" in model.stepping
    assert "at most 5 ms" in rover.stepping
