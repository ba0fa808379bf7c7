"""FMUs of other tools as law, driver and plant of a run: equal numbers, mishaps, maps, broken files."""

import copy
import gc
import math
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from typer.testing import CliRunner

import offtrack
from controllers.trailer import Combination
from offtrack.commands.cli import app
from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import FmuLaw, law_of, law_signals
from offtrack.exchange.fmi_import.fmu_plant import SteeringActuators
from offtrack.exchange.fmi_import.instance import FmuInstance
from offtrack.exchange.fmi_import.mapping import PartSignals, Signal, map_file, read_map
from scenarios.assembly.adapters import trailer_geometry
from scenarios.catalogue import ODOMETRY, resolve
from tests.fmus.models import LAW, LAW_CODE, Quantity, build_fmu, proportional_law, pursuit_driver, rolling_plant
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

SIGNALS = law_signals(2, 2)
SHORT: dict[str, Any] = {"off_tracking": "truth", "course.turn_deg": 30.0, "course.entry": 20.0, "course.exit": 5.0}


def run(**settings: object) -> offtrack.Run:
    """A short run; points in the names of keys are written as __."""
    return offtrack.run("roundabout", settings=SHORT | {key.replace("__", "."): x for key, x in settings.items()})


@pytest.fixture(scope="module")
def law(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return proportional_law(tmp_path_factory.mktemp("law"))


@pytest.fixture
def own_law(law: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(law, tmp_path / "own.fmu"))


def opened(law: Path, **parameters: float) -> FmuInstance:
    fmu = open_fmu(law)
    return FmuInstance(fmu, read_map(fmu, SIGNALS), parameters)


def processes() -> set[int]:
    return {int(number) for file in Path("/proc/self/task").glob("*/children") for number in file.read_text().split()}


@pytest.fixture
def without_collection() -> Iterator[None]:
    """No collection of garbage, which ends the processes of FMUs that nobody else has ended."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.slow
@pytest.mark.usefixtures("without_collection")
def test_the_processes_of_fmus_end_with_the_session(law: Path, tmp_path: Path) -> None:
    """Law, driver and plant; a snapshot has three of its own, and so does one that is run to the end."""
    plant = rolling_plant(tmp_path, load_vehicle("uk_longer_semitrailer").units[0].rear_hitch[0], 8.0)
    parts = {"trailer_steering": str(law), "driver.kind": str(pursuit_driver(tmp_path)), "plant.fmu": str(plant)}
    before = processes()
    with offtrack.Session("roundabout", settings=SHORT | parts) as session:
        session.step(0.05)
        assert len(processes() - before) == 3
        with copy.deepcopy(session) as other:
            assert len(processes() - before) == 6
            other.step(0.05)
        assert len(processes() - before) == 3
        session.step(0.05)
    assert processes() == before


@pytest.mark.usefixtures("without_collection")
@pytest.mark.parametrize("mishap", ["late part", "interrupt"])
def test_the_processes_of_fmus_end_however_a_run_does(law: Path, mishap: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The law is there before the source of off-tracking is refused, and before the first step."""
    before = processes()
    if mishap == "late part":
        with pytest.raises(ValueError, match="nowhere") as refused:  # its traceback keeps the law
            run(trailer_steering=str(law), off_tracking="nowhere:Source")
        assert refused.value.__traceback__ is not None
    else:
        monkeypatch.setattr(FmuLaw, "step", interrupted)
        assert run(trailer_steering=str(law)).summary["outcome"] == "interrupted"
    assert processes() == before


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_run_whose_fmu_crashes_has_failed_and_says_why(law: Path) -> None:
    """A process that is killed, as for lack of memory, says nothing about the vehicle."""
    result = run(trailer_steering=str(law), steering__mishap=1.0)
    assert result.outcome.startswith("failed: ")
    assert "SIGSEGV" in result.outcome


def test_an_fmu_that_is_killed_while_it_starts_is_started_once_more(
    own_law: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes, start = list[subprocess.Popen[bytes]](), subprocess.Popen

    def first_is_killed(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        processes.append(start(*arguments, **options))
        if len(processes) == 1:
            processes[0].kill()
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", first_is_killed)
    assert opened(own_law).step(10, {"off_tracking": 1.0})
    assert len(processes) == 2


@pytest.mark.parametrize("version", [2, 3])
def test_a_copy_of_an_instance_goes_on_from_its_state(tmp_path: Path, version: Literal[2, 3]) -> None:
    summing = build_fmu(tmp_path, "summing", LAW, "x[0] += v[0] * dt; v[1] = v[2] = x[0];", version=version)
    first = opened(summing)
    first.step(100, {"off_tracking": 1.0})
    second = copy.deepcopy(first)
    assert first.step(100, {"off_tracking": 1.0})["steer_demand_1"] == pytest.approx(0.2)
    assert second.step(100, {"off_tracking": 3.0})["steer_demand_1"] == pytest.approx(0.4)


def test_an_fmu_that_does_not_give_its_state_is_not_copied(tmp_path: Path) -> None:
    instance = opened(build_fmu(tmp_path, "stubborn", LAW, LAW_CODE, keeps_state=False))
    with pytest.raises(ValueError, match="cannot be copied: it does not declare canGetAndSetFMUstate"):
        copy.deepcopy(instance)


def test_units_signs_and_offsets_of_a_map(own_law: Path) -> None:
    """The input is in millimetres with the other sign, the outputs in degrees, one of them off by 2 degrees."""
    map_file(own_law).write_text(
        '[inputs]\noff_tracking = { signal = "off_tracking", unit = "mm", factor = -1.0 }\n'
        '[outputs]\nsteer_demand_1 = { signal = "steer_demand_1", unit = "deg" }\n'
        'steer_demand_2 = { signal = "steer_demand_2", unit = "deg", offset = 2.0 }\n[parameters]\ngain = 0.5\n',
        encoding="utf-8",
    )
    found = opened(own_law).step(10, {"off_tracking": 0.01})  # -10 mm, -5 deg
    assert found["steer_demand_1"] == pytest.approx(np.deg2rad(-5.0))
    assert found["steer_demand_2"] == pytest.approx(np.deg2rad(-3.0))


def test_a_map_that_is_no_file_is_not_passed_over(own_law: Path) -> None:
    os.mkfifo(map_file(own_law))
    with pytest.raises(ValueError, match=r"own\.fmu\.toml is a named pipe"):
        opened(own_law)


def test_one_output_gives_several_signals(own_law: Path) -> None:
    """A list of signals, plain or in a table; each gets the value in its unit."""
    map_file(own_law).write_text(
        '[inputs]\noff_tracking = "off_tracking"\n'
        '[outputs]\nsteer_demand_2 = { signal = ["steer_demand_1", "steer_demand_2"], unit = "deg" }\n',
        encoding="utf-8",
    )
    found = opened(own_law).step(10, {"off_tracking": 1.0})
    assert found == {f"steer_demand_{k}": pytest.approx(np.deg2rad(0.2)) for k in (1, 2)}


def test_ganged_axles_need_one_demand(tmp_path: Path) -> None:
    """Axles on one actuator: an FMU with one output steers as one that gives it for each; others need both."""
    one = build_fmu(tmp_path, "one", (LAW[0], LAW[1], LAW[3]), "v[1] = v[2] * v[0];")
    single, both = (
        run(trailer_steering=str(law), steer_groups="single").summary["steer"]
        for law in (one, proportional_law(tmp_path))
    )
    assert single == both
    with pytest.raises(ValueError, match="no variable is connected to trailer_steering's signal steer_demand_2"):
        run(trailer_steering=str(one), steer_groups="common_centre")


def test_lengths_that_are_not_those_of_the_data_sheet_are_named(tmp_path: Path) -> None:
    plant = rolling_plant(tmp_path, 1.5, 8.0)
    with pytest.raises(ValueError, match=r"unit 2 begins 0\.73 m from the hitch of tractor, which is at x = 0\.77"):
        run(plant__fmu=str(plant))


def test_a_first_map_connects_by_names_and_units(tmp_path: Path) -> None:
    plant = rolling_plant(tmp_path, 0.77, 8.0)
    map_file(plant).unlink()
    answer = CliRunner().invoke(app, ["fmu", "map", str(plant), "--part", "plant"])
    assert answer.exit_code == 0, answer.output
    text = map_file(plant).read_text(encoding="utf-8")
    for line in ('"delta" = "steer"', '"a" = "acceleration"', '"unit1.psi" = "psi_1"', '"unit2.x" = "x_2"'):
        assert f"\n{line}" in text
    again = CliRunner().invoke(app, ["fmu", "map", str(plant), "--part", "plant"])
    assert again.exit_code == 2
    assert map_file(plant).read_text(encoding="utf-8") == text


MAPS = {
    "not TOML": ("inputs = [", "own.fmu.toml"),
    "unknown table": ("[input]\n", "unknown key 'input'; did you mean 'inputs'?"),
    "another part": ('part = "driver"\n', "this FMU is used as trailer_steering"),
    "unknown variable": ('[inputs]\nofftracking = "off_tracking"\n', "has no variable 'offtracking'"),
    "unknown signal": ('[inputs]\noff_tracking = "offtracking"\n', "has no signal 'offtracking'"),
    "an output as input": ('[inputs]\nsteer_demand_1 = "speed"\n', "is of causality 'output'"),
    "a number for a signal": ("[inputs]\noff_tracking = 3\n", "must be the name of a signal"),
    "unknown key of a link": ('[inputs]\noff_tracking = { signal = "speed", gain = 2 }\n', "unknown key 'gain'"),
    "a unit of something else": ('[inputs]\noff_tracking = "speed"\n', "is in m, the signal speed in m/s"),
    "unknown unit": ('[inputs]\noff_tracking = { signal = "speed", unit = "mph" }\n', "unit = 'mph'"),
    "a factor that is none": (
        '[inputs]\noff_tracking = { signal = "off_tracking", factor = inf }\n',
        "must be a finite number",
    ),
    "a signal twice": (
        '[outputs]\nsteer_demand_1 = "steer_demand_1"\nsteer_demand_2 = "steer_demand_1"\n',
        "two variables give the signal steer_demand_1",
    ),
    "no signal in a list": ("[outputs]\nsteer_demand_1 = []\n", "must be the name of signals"),
    "an input of two signals": ('[inputs]\noff_tracking = ["speed", "steer"]\n', "must be the name of a signal"),
    "no outputs": ('[inputs]\noff_tracking = "off_tracking"\n', "no variable is connected"),
    "unknown parameter": ("[parameters]\nganz = 1.0\n", "has no variable 'ganz'"),
    "half a millisecond": ("period = 0.0005\n", "must be a whole number of milliseconds"),
    "no time": ("timeout = 0\n", "must be positive"),
}
OUTPUTS = '[outputs]\nsteer_demand_1 = "steer_demand_1"\nsteer_demand_2 = "steer_demand_2"\n'


@pytest.mark.parametrize("name", MAPS)
def test_a_wrong_map_is_one_line(own_law: Path, name: str) -> None:
    text, line = MAPS[name]
    needs_outputs = "[outputs]" not in text and name not in ("no outputs", "not TOML")
    map_file(own_law).write_text(text + (OUTPUTS if needs_outputs else ""), encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*own\.fmu[^\n]*$") as caught:
        opened(own_law)
    assert line in str(caught.value)


def test_an_fmu_has_its_parameters_as_options_and_cannot_be_every_part(law: Path) -> None:
    vehicle = load_vehicle("uk_longer_semitrailer")
    made = law_of(str(law))
    assert made.options[0].name == "gain"
    with pytest.raises(ValueError, match=r"steering\.gain = 'x'"):
        made(trailer_geometry(vehicle, 1), combination=Combination(vehicle, 1), gain="x")
    with pytest.raises(ValueError, match="an FMU can't be this part"):
        resolve("odometry", str(law), ODOMETRY)


def test_declared_units_are_used(tmp_path: Path) -> None:
    """An output in degrees by its own unit definition needs no word in a map."""
    unit = '<UnitDefinitions><Unit name="grad"><BaseUnit rad="1" factor="0.015707963"/></Unit></UnitDefinitions>'
    quantities = (Quantity("a", "input"), Quantity("angle", "output", "grad"))
    fmu = open_fmu(build_fmu(tmp_path, "deg", quantities, "v[1] = v[0];", units=unit))
    part = PartSignals(kind="part", inputs=(Signal("a", "-", ""),), outputs=(Signal("angle", "rad", ""),))
    instance = FmuInstance(fmu, read_map(fmu, part), {})
    assert instance.step(10, {"a": 100.0})["angle"] == pytest.approx(np.pi / 2, abs=1e-6)


STEP = 10  # of the loop [ms]


def command_of(vehicle: Vehicle, steer: float) -> VehicleCommand:
    """Demands of all axles that differ, as a law gives them that knows nothing of groups."""
    n_trailer = vehicle.n_by_law
    return VehicleCommand(steer, 0.0, tuple(0.5 * steer * (k - 1) for k in range(n_trailer)))


@pytest.mark.parametrize("name", ["uk_longer_semitrailer", "uk_longer_semitrailer_grouped", "rigid_truck_8x4"])
def test_axles_move_as_those_of_the_plant_here(name: str) -> None:
    """Through lag and limits of rate and angle, by an independent path: the plant integrates, this is a closed form."""
    vehicle = load_vehicle(name)
    plant, actuators = Plant(vehicle, Surface(friction=0.8)), SteeringActuators(vehicle, given=())
    state, angles = plant.initial_state(Pose2(0.0, 0.0, 0.0), 2.0), actuators.straight()
    for k in range(300):
        command = command_of(vehicle, math.radians(50.0 if k < 180 else -3.0))
        state = plant.step(state, command, STEP)
        angles = actuators.turned(angles, command, 1e-3 * STEP)
        np.testing.assert_allclose(angles, plant.observe(state, 0).steer, atol=2e-4)  # of the plant's ticks of 1 ms
    assert np.ptp(angles) > 0.01


def test_an_axle_whose_angle_the_fmu_gives_gets_the_demand() -> None:
    """Its actuator is inside the FMU, and must not lag twice."""
    vehicle = load_vehicle("uk_longer_semitrailer")
    actuators = SteeringActuators(vehicle, given={"steer_angle_1", "steer_angle_3"})
    command = VehicleCommand(0.2, 0.0, (0.1, -0.1))
    angles = actuators.turned(actuators.straight(), command, 0.05)
    assert actuators.command(command, angles).steer == 0.2
    assert angles[2] == -0.1
    assert angles[1] == pytest.approx(math.radians(20.0) * 0.05)  # at its limit of rate: 0.1 rad are far
