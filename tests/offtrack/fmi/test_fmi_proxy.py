"""Laws as FMUs with a Python process behind them: the same law, and what happens to the process."""

import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp import ssd
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from controllers.trailer import Combination
from estimators.estimates import Health, OffTracking
from offtrack.commands.cli import app
from offtrack.exchange.fmi_export import fmu_writer
from offtrack.exchange.fmi_export.fmu_writer import fmu_bytes
from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import off_tracking_signals
from offtrack.exchange.fmi_import.mapping import first_map, map_file, read_map
from offtrack.exchange.fmi_import.numbered_signals import (
    PATH_POINTS,
    estimate_of,
    estimate_values,
    reading_values,
    truth_of,
    truth_signals,
    truth_values,
)
from offtrack.exchange.fmi_proxy.parts import driver_proxy, law_proxy, sensor_proxy
from offtrack.exchange.fmi_proxy.system import FmuSystem, fmu_system
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.channel import InLine
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import Scenario, load_scenario
from tests.fmus.plants import Slave, c_compiler
from tests.fmus.proxies import USED, alive, estimate, reading, stand_in
from vehicle.combination.description import load_vehicle

pytestmark = pytest.mark.skipif(c_compiler() is None, reason="no C compiler")
VEHICLE = "uk_longer_semitrailer"


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The law in both versions, compiled by the system's compiler: the quickest."""
    folder = tmp_path_factory.mktemp("laws")
    proxy = law_proxy("path_preview", load_vehicle(VEHICLE), {"gain": 0.5})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu_writer, "_has_zig", lambda: False)
        for version in (2, 3):
            (folder / f"{version}.fmu").write_bytes(
                fmu_bytes(proxy.exported(version), version, ("linux64",), optimisation=0)
            )
    return {version: folder / f"{version}.fmu" for version in (2, 3)}


def slave_of(fmus: Mapping[int, Path], version: int, python: str = sys.executable, **values: float) -> Slave:
    return Slave(fmus[version], fmus[version].with_suffix(""), values, {"python": python})


@pytest.mark.slow
def test_a_host_of_60_hz_gets_the_demands_of_one_of_100_hz(fmus: dict[int, Path]) -> None:
    """The process does whole milliseconds; after half a second both have done 500."""
    ends = []
    for rate, steps in ((100, 50), (60, 30)):
        slave = slave_of(fmus, 3)
        slave.set(estimate_values(0, estimate(0, 0.2), USED) | reading_values(reading(0)))
        for _ in range(steps):
            slave.step(1.0 / rate)
        ends.append(slave.get(slave.outputs))
        slave.close()
    assert ends[0] == ends[1]
    assert any(ends[0])


@pytest.mark.slow
def test_the_law_in_its_process_steers_as_the_same_law_here(fmus: dict[int, Path]) -> None:
    """Bitwise: values go over as they are. Its guard is that of a run, and steps of 10 ms are held in between."""
    vehicle = load_vehicle(VEHICLE)
    law = trailer_law("path_preview", trailer_geometry(vehicle, 1), Combination(vehicle, 1), {"gain": 0.5})
    memory, slave, newest = law.init(), slave_of(fmus, 3), None
    for tick in range(0, 1000, 10):
        newest = estimate(tick - 100, 0.3 * np.sin(tick / 300.0)) if tick % 100 == 0 and tick >= 100 else newest
        slave.set(estimate_values(tick, newest, USED) | reading_values(reading(tick)))
        slave.step()
        if tick % 20 == 0:
            memory, command = law.step(memory, tick, newest, reading(tick))
        assert slave.get(slave.outputs) == command.angles.tolist()
    slave.close()
    assert np.all(command.angles != 0.0)


@pytest.mark.parametrize("version", [2, 3])
def test_the_process_ends_with_the_instance_and_begins_anew_after_a_reset(
    fmus: dict[int, Path], version: int, tmp_path: Path
) -> None:
    python = stand_in(tmp_path)
    slave = slave_of(fmus, version, python)
    slave.step()
    ticks, first = slave.get(slave.outputs)
    assert (ticks, alive(int(first))) == (10.0, True)
    slave.fmu.reset()
    assert not alive(int(first))
    slave.begin(None, {"python": python})
    slave.step(0.02)
    ticks, second = slave.get(slave.outputs)
    assert ticks == 20.0
    slave.fmu.terminate()
    assert not alive(int(second))
    assert slave.get(slave.outputs) == [ticks, second]
    slave.close()


@pytest.mark.parametrize("version", [2, 3])
def test_a_killed_process_is_an_error_with_a_message(fmus: dict[int, Path], version: int, tmp_path: Path) -> None:
    slave = slave_of(fmus, version, stand_in(tmp_path))
    slave.step()
    process = int(slave.get(slave.outputs)[1])
    os.kill(process, signal.SIGKILL)
    with pytest.raises(Exception, match="failed"):
        slave.step()
    assert slave.messages[-1] == "at 0.01 s: its Python process failed: it was ended by signal 9 (Killed)"
    with pytest.raises(Exception, match="failed"):
        slave.step()
    assert slave.messages[-1] == "its Python process has ended: reset the instance"
    slave.close()
    assert not alive(process)


@pytest.mark.parametrize(
    ("mishap", "reason"),
    [
        ("time.sleep(60)", "it does not answer within 0.3 s"),
        ("sys.exit('the sea is too high')", "it exited with code 1 (it said: the sea is too high)"),
        ("answer(b'no such path', b'-'); continue", "no such path"),
        ("answer(b'1234'); continue", "it gave 4 bytes, not 2 values"),
        ("answers.write(b'+\\xff\\xff\\xff\\xff'); continue", "it gave an answer of 4294967295 bytes"),
    ],
)
def test_a_process_that_fails_is_one_line(fmus: dict[int, Path], mishap: str, reason: str, tmp_path: Path) -> None:
    slave = slave_of(fmus, 2, stand_in(tmp_path, mishap), timeout=0.3)
    begin = time.monotonic()
    with pytest.raises(Exception, match="failed"):
        slave.step()
    assert time.monotonic() - begin < 3.0
    assert slave.messages == [f"at 0 s: its Python process failed: {reason}"]
    slave.close()


@pytest.mark.parametrize(
    ("python", "reason"),
    [("/nowhere/python", "'/nowhere/python' cannot be started: No such file or directory; the parameter 'python'"),
     ("/bin/false", "start: its Python process failed: it exited with code 1")],
)  # fmt: skip
def test_a_python_that_does_not_start_is_one_line(fmus: dict[int, Path], python: str, reason: str) -> None:
    slave = Slave.__new__(Slave)
    with pytest.raises(Exception, match="failed"):
        slave.__init__(fmus[3], fmus[3].with_suffix(""), {}, {"python": python})  # type: ignore[misc]
    assert reason in slave.messages[-1]
    slave.close()


def test_steps_of_other_lengths_and_states_are_refused(fmus: dict[int, Path], tmp_path: Path) -> None:
    slave = slave_of(fmus, 3, stand_in(tmp_path))
    assert not slave.description.coSimulation.canGetAndSetFMUstate
    for call, reason in (
        (lambda: slave.step(-0.001), "communication step of -0.001 s must be above 0"),
        (slave.fmu.getFMUState, "the state of this FMU cannot be taken or set: it is in another process"),
        (lambda: slave.set({"speed": np.inf}), "must be finite and below 1e+12"),
        (lambda: slave.set({"timeout": 1.0}), "is a parameter, which is fixed after the initialisation"),
    ):
        with pytest.raises(Exception, match="failed"):
            call()
        assert reason in slave.messages[-1]
    slave.close()


def test_signals_keep_an_estimate() -> None:
    for one in (
        estimate(1000),
        replace(estimate(900), health=Health.LOST, std=np.inf, value=0.0),
        replace(estimate(0, points=1), health=Health.DEGRADED, bridged=0.3),
    ):
        other = estimate_of(1100, estimate_values(1100, one, USED))
        assert other is not None
        for name in OffTracking.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name), name)
    assert estimate_of(50, dict.fromkeys(USED, 0.0) | estimate_values(50, None, USED)) is None
    long = estimate_of(0, estimate_values(0, estimate(0, points=1000), USED))
    assert long is not None
    assert len(long.path) == PATH_POINTS
    np.testing.assert_array_equal(long.path[[0, -1]], estimate(0, points=1000).path[[0, -1]])


@pytest.fixture(scope="module")
def drive() -> tuple[TrailerSession, Scenario]:
    """Four seconds of a run, of which sensor and driver are asked again."""
    settings = ["off_tracking=truth", "trailer_steering=none", "surface.cross_fall=0.03", "rig.latency=0.05"]
    scenario = load_scenario("roundabout", settings)
    session = TrailerSession(assemble(scenario, 3), worker=InLine())
    for _ in range(400):
        session.advance()
    session.close()
    return session, scenario


def test_motion_goes_over_as_signals(drive: tuple[TrailerSession, Scenario]) -> None:
    """Angles round a rotation by some 1e-16. Without poses of bodies these stand on the ground."""
    session, _ = drive
    truth, vehicle = session.rows[-1].truth, session.parts.vehicle
    values = truth_values(truth)
    assert values.keys() == {one.name for one in truth_signals(vehicle)}
    other = truth_of(truth.tick, values, vehicle, lambda *_: np.eye(4))
    np.testing.assert_array_equal(other.poses, truth.poses)
    np.testing.assert_array_equal(other.velocities, truth.velocities)
    np.testing.assert_array_equal(other.steer, truth.steer)
    assert truth.wheel_speeds is not None
    np.testing.assert_array_equal(other.wheel_speeds, truth.wheel_speeds)
    np.testing.assert_allclose(other.bodies, truth.bodies, atol=1e-15)
    standing = {name: 0.0 if name.startswith("body_") else value for name, value in values.items()}
    assert np.array_equal(truth_of(0, standing, vehicle, lambda *_: 2.0 * np.eye(4)).bodies[1], 2.0 * np.eye(4))


def test_a_first_map_connects_equal_names_first_and_lists_texts(
    drive: tuple[TrailerSession, Scenario], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "sensor.fmu"
    monkeypatch.setattr("offtrack.exchange.fmi_import.fmu_file._check_binary", lambda *_: None)
    file.write_bytes(fmu_bytes(sensor_proxy(drive[1], 3).exported(2), 2, ()))
    fmu, part = open_fmu(file), off_tracking_signals(drive[0].parts.vehicle)
    by_names = read_map(fmu, part)
    assert {link.signal for link in by_names.inputs} == {one.name for one in part.inputs} - {"time"}
    text = first_map(fmu, part).replace('# "frames" = ""', '"frames" = "images"')
    map_file(file).write_text(text, encoding="utf-8")
    assert replace(read_map(fmu, part), parameters={}) == by_names
    assert read_map(fmu, part).parameters == {"frames": "images"}


@pytest.fixture(scope="module")
def loop() -> FmuSystem:
    """Two steered trailers on a bank."""
    settings = ["off_tracking=truth", "vehicle=b_double_steered", "surface.cross_fall=0.03", "surface.friction=0.5"]
    return fmu_system(load_scenario("roundabout", settings), 1)


def test_a_system_connects_what_there_is_in_the_same_units(loop: FmuSystem) -> None:
    """Valid by the schema of SSP; every input of sensors, driver, ground and laws has one source."""
    etree = pytest.importorskip("lxml.etree")  # FMPy has it
    schema = etree.XMLSchema(etree.parse(Path(ssd.__file__).parent / "schema" / "SystemStructureDescription.xsd"))
    schema.assertValid(etree.fromstring(loop.description()))
    variables = {
        (name, one.signal.name): one for name, exported in loop.components.items() for one in exported.variables
    }
    for one in loop.connections:
        source, target = variables[one.source, one.output], variables[one.target, one.input]
        assert (source.causality, target.causality) == ("output", "input")
        assert source.signal.unit == target.signal.unit, one
    targets = [(one.target, one.input) for one in loop.connections]
    inputs = {key for key, one in variables.items() if one.causality == "input" and key[0] != "plant"}
    assert len(targets) == len(set(targets))
    assert inputs <= set(targets)
    assert ("plant", "steer_trailer_2") in targets
    assert variables["plant", "friction_wheel_1"].signal.start == 0.5
    assert variables["plant", "start_speed"].signal.start > 0.0
    assert set(loop.components) == {"plant", "driver", "ground", "sensor_2", "law_2", "sensor", "law"}
    assert {one.source for one in loop.connections if one.target == "law_2"} == {"sensor_2"}
    grounds = {one.signal.name for one in loop.components["ground"].variables if one.causality == "output"}
    for name in grounds:  # the plant starts on its ground, also where a runner gives it zeros at first
        assert variables["plant", name].signal.start == variables["ground", name].signal.start


def test_fmpy_finds_no_problem(
    fmus: dict[int, Path], drive: tuple[TrailerSession, Scenario], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With laws, sensors, drivers, and the ground as the command writes it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fmu_writer, "_has_zig", lambda: False)
    Path("sensor.fmu").write_bytes(fmu_bytes(sensor_proxy(drive[1], 3).exported(2), 2, ()))
    Path("driver.fmu").write_bytes(fmu_bytes(driver_proxy(drive[1]).exported(3), 3, ()))
    for file in (*fmus.values(), "sensor.fmu", "driver.fmu"):
        assert validate_fmu(str(file)) == []
    result = CliRunner().invoke(app, ["fmu", "ground", "roundabout", "--set", "surface.grade=0.02", "--fmi", "2"])
    assert result.exit_code == 0, result.output
    assert validate_fmu("roundabout_ground.fmu") == []
