"""FMUs with a Python process behind them: in runs with cameras, compiled by other means, again and again.

The library for Windows needs the extra ``zig``; it is compiled, not run.
"""

import json
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu

import offtrack
from offtrack.exchange.fmi_export.fmu_writer import fmu_bytes, write_fmu
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from offtrack.exchange.fmi_import.mapping import map_file
from offtrack.exchange.fmi_proxy.parts import driver_proxy, law_proxy, sensor_proxy
from offtrack.exchange.fmi_proxy.system import fmu_system
from scenarios.assembly.adapters import vehicle_of
from scenarios.options.scenario import load_scenario
from tests.fmus.hosts import compiled_by_fmpy, host_here
from tests.fmus.plants import Slave
from tests.fmus.proxies import alive, stand_in
from tests.fmus.systems import off_tracking, run_in_order
from tests.soak.measure import soaked, usage
from vehicle.combination.description import load_vehicle

VEHICLE = "uk_longer_semitrailer"


def law(folder: Path, version: int, name: str = "path_preview", platforms: tuple[str, ...] = ("linux64",)) -> Path:
    file = folder / f"{name.replace(':', '_')}{version}.fmu"
    file.write_bytes(fmu_bytes(law_proxy(name, load_vehicle(VEHICLE), {}).exported(version), version, platforms))
    return file


def test_sensor_law_driver_and_plant_as_fmus_with_cameras(tmp_path: Path) -> None:
    """Each alone and all together: the plant rounds by 1e-13, the cameras see the same images."""
    scenario = load_scenario("roundabout", ["course.turn_deg=60"])
    files = {name: tmp_path / f"{name}.fmu" for name in ("off_tracking", "trailer_steering", "driver", "plant.fmu")}
    proxies = {"off_tracking": sensor_proxy(scenario, 1), "driver": driver_proxy(scenario)}
    for name, proxy in proxies.items():
        files[name].write_bytes(fmu_bytes(proxy.exported(3), 3, ("linux64",)))
    law(tmp_path, 2).rename(files["trailer_steering"])
    write_fmu(files["plant.fmu"], plant_model(VEHICLE, None, wind=False), 3, ("linux64",))

    def run(*names: str) -> tuple[offtrack.Run, str, Path]:
        keys: dict[str, object] = {name: str(files[name]) for name in names}
        out = tmp_path / f"run-{len(names)}-{names[:1]}"
        frames = tmp_path / f"frames-{len(names)}"
        map_file(files["off_tracking"]).write_text(f'[parameters]\n"frames" = "{frames}"\n', encoding="utf-8")
        done = offtrack.run("roundabout", settings={**SHORT, **keys})
        done.save(out)
        return done, json.loads((out / "manifest.json").read_text())["frames_sha256"], frames

    own, sha, _ = run()
    for names in (("off_tracking",), ("trailer_steering",), ("driver",), ("plant.fmu",), tuple(files)):
        other, other_sha, frames = run(*names)
        difference = np.abs(np.asarray(other["off_tracking_true"]) - np.asarray(own["off_tracking_true"]))
        sys.stdout.write(f"{', '.join(names)}: {np.nanmax(difference):.2g} m from the run without FMUs\n")
        assert np.nanmax(difference) < 1e-6, names
        if "off_tracking" in names:
            other_sha = (frames / "frames_sha256.txt").read_text().strip()
        if "plant.fmu" not in names:  # a body that is 1e-13 m off may turn a pixel
            assert other_sha == sha, names


@pytest.mark.parametrize("name", ["none", "command_steer", "ct_at", "virtual_driver", "lqr", "combined", "mpc"])
def test_every_law_is_the_same_as_an_fmu(name: str, tmp_path: Path) -> None:
    settings = {"course.turn_deg": 30.0, "course.entry": 20.0, "course.exit": 5.0, "off_tracking": "truth"}
    own = offtrack.run("roundabout", settings=settings | {"trailer_steering": name})
    other = offtrack.run("roundabout", settings=settings | {"trailer_steering": str(law(tmp_path, 3, name))})
    for signal_name in own.log.names:
        np.testing.assert_array_equal(other[signal_name], own[signal_name], signal_name)


@pytest.mark.parametrize(("cycles", "real"), [(2000, False), (40, True)])
def test_instances_again_and_again_leave_nothing(cycles: int, real: bool, tmp_path: Path) -> None:
    """No process, descriptor, thread or memory; a small program takes Python's place a thousand times.

    Half of the cycles warm up. An instance has some 10 kB, so that a thousand of them would be 10 MB.
    """
    python, folder = {"python": sys.executable if real else stand_in(tmp_path)}, tmp_path / "unpacked"
    slave = Slave(law(tmp_path, 3), folder, {}, python)
    slave.step()
    assert soaked(lambda: slave.again(folder, python), usage(), cycles).wrong(0.0) is None
    slave.close()


def test_the_process_ends_when_its_host_is_killed(tmp_path: Path) -> None:
    file = law(tmp_path, 3)
    code = (
        "import sys, pathlib\n"
        "from tests.fmus.plants import Slave\n"
        f"slave = Slave(pathlib.Path({str(file)!r}), pathlib.Path({str(tmp_path / 'x')!r}), {{}}, "
        "{'python': sys.executable})\n"
        "print(pathlib.Path('/proc/thread-self/children').read_text(), flush=True)\n"
        "input()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as host:
        assert host.stdout is not None
        (process,) = map(int, host.stdout.readline().split())
        assert alive(process)
        host.send_signal(signal.SIGKILL)
        host.wait()
    for _ in range(100):
        if not alive(process) or "Z" in Path(f"/proc/{process}/stat").read_text().split()[2]:
            break
        threading.Event().wait(0.1)
    else:
        pytest.fail("the process goes on without its host")


@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_compiles_it_from_its_own_sources(version: int, tmp_path: Path) -> None:
    file = law(tmp_path, version, platforms=())
    compiled_by_fmpy(file)
    assert validate_fmu(str(file)) == []
    slave = Slave(file, tmp_path / "unpacked", {}, {"python": sys.executable})
    slave.step()
    slave.close()


@pytest.mark.parametrize("version", [2, 3])
def test_a_program_in_c_loads_and_steps_it(version: int, tmp_path: Path) -> None:
    file, angles = law(tmp_path, version, "tests.fmus.proxies:Straightener"), [0.1, 0.1, 0.2, 0.3]
    rows, outputs = {"articulation_1": angles}, ["steer_demand_1", "steer_demand_2"]
    host = host_here(tmp_path, OFFTRACK_PYTHON=sys.executable)
    done = host.run(file, tmp_path / "x", rows=rows, outputs=outputs)
    assert (done.returncode, done.stderr) == (0, "")
    slave = Slave(file, tmp_path / "unpacked", {}, {"python": sys.executable})
    expected = [slave.get(outputs)]
    for angle in angles:
        slave.set({"articulation_1": angle})
        slave.step()
        expected.append(slave.get(outputs))
    slave.close()
    np.testing.assert_array_equal(np.loadtxt(done.stdout.splitlines()), expected)
    assert expected[-1][0] != 0.0


SHORT: dict[str, object] = {"course.turn_deg": 60.0}
SYSTEMS: dict[str, tuple[str, dict[str, object]]] = {
    "level": ("roundabout", SHORT),
    "slippery": ("roundabout", {**SHORT, "surface.friction": 0.2}),
    "banked slope": ("roundabout", {**SHORT, "surface.cross_fall": 0.04, "surface.grade": 0.02}),
    "ice on one side": ("roundabout", {**SHORT, "surface.friction_right": 0.2}),
    "rough": ("roundabout", {**SHORT, "surface.roughness": "C", "surface.potholes": 5.0}),
    "gust": ("roundabout", {**SHORT, "vehicle": "eu_tractor_semitrailer", "trailer_steering": "none",
                            "wind.speed": 15.0, "wind.start": 10.0, "wind.length": 30.0}),
    "two steered trailers": ("roundabout", {**SHORT, "vehicle": "b_double_steered"}),
    "two steered trailers on a rough bank": (
        "roundabout",
        {**SHORT, "vehicle": "b_double_steered", "surface.cross_fall": 0.03, "surface.roughness": "B",
         "trailer_steering": "ct_at"},
    ),
    "patches of a farm track": ("farm-track", {}),
    "slopes of a depot": ("depot", {}),
    "to and fro": ("reversing", {}),
    "a recorded drive": ("roundabout", SHORT),
}  # fmt: skip
LONGEST = 60.0  # compared [s]


@pytest.mark.parametrize("case", SYSTEMS)
def test_a_system_gives_the_numbers_of_the_run(case: str, tmp_path: Path) -> None:
    """Component after component, as the loop does: the same up to rounding, poses of all units and off-tracking.

    A driver that is prescribed repeats steer angles and speeds, whatever the truck does.
    """
    name, settings = SYSTEMS[case]
    settings, folder = {"off_tracking": "truth", **settings}, tmp_path
    if case == "a recorded drive":
        run = offtrack.run(name, settings=settings)
        columns = (run.log["time"], np.degrees(run["steer_tractor"]), 3.6 * np.asarray(run["v_x_tractor"]))
        header, settings["driver.trace"] = "time_s,steer_deg,speed_kmh", str(tmp_path / "drive.csv")
        np.savetxt(tmp_path / "drive.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    own = offtrack.run(name, settings=settings)
    scenario = load_scenario(name, [f"{key}={value}" for key, value in settings.items()])
    ssp, vehicle = folder / "loop.ssp", vehicle_of(scenario)
    ssp.write_bytes(fmu_system(scenario, own.summary["seed"]).content(("linux64",)))
    n = min(len(own["x_tractor"]), round(LONGEST / 0.01))
    outputs, _ = run_in_order(ssp, folder / "system", 0.01 * (n - 1), sys.executable)
    worst = 0.0
    for k, unit in enumerate(vehicle.units, start=1):
        for axis in ("x", "y", "psi"):
            worst = max(worst, np.abs(outputs[f"{axis}_{k}"] - np.asarray(own[f"{axis}_{unit.name}"])[:n]).max())
    trailer = vehicle.units[-1]
    assert trailer.follow_x is not None
    found = off_tracking(outputs, len(vehicle.units), -trailer.follow_x, trailer.roll_axis_height)
    worst = max(worst, np.nanmax(np.abs(found - np.asarray(own["off_tracking_true"])[:n])))
    sys.stdout.write(f"{name} {settings}: {worst:.2g} m over {0.01 * n:.1f} s\n")
    assert worst < 1e-9


def test_fmpy_runs_a_system_a_step_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FMPy passes all values on at the end of a step: driver and law act 10 and 30 ms later, the ground 10 ms.

    At 2.8 m/s this moves the follow point by some millimetres.
    """
    keys: dict[str, object] = {"off_tracking": "truth", "course.turn_deg": 90.0, "surface.cross_fall": 0.03}
    ssp, trailer = tmp_path / "loop.ssp", load_vehicle(VEHICLE).units[1]
    scenario = load_scenario("roundabout", [f"{key}={value}" for key, value in keys.items()])
    ssp.write_bytes(fmu_system(scenario, 1).content(("linux64",)))
    own = np.asarray(offtrack.run("roundabout", settings=keys)["off_tracking_true"])
    monkeypatch.setenv("OFFTRACK_PYTHON", sys.executable)
    rows = simulate_ssp(str(ssp), stop_time=30.0, step_size=0.01)
    outputs = {name.removeprefix("plant."): rows[name] for name in rows.dtype.names if name.startswith("plant.")}
    assert trailer.follow_x is not None
    by_fmpy = off_tracking(outputs, 2, -trailer.follow_x, trailer.roll_axis_height)
    n = min(len(own) - 1, len(by_fmpy))
    assert np.nanmax(np.abs(by_fmpy[:n] - own[1 : n + 1])) < 0.02


def test_a_system_in_order_sees_the_images_of_the_run(tmp_path: Path) -> None:
    settings = ["course.turn_deg=60"]
    ssp, trailer = tmp_path / "loop.ssp", load_vehicle(VEHICLE).units[1]
    ssp.write_bytes(fmu_system(load_scenario("roundabout", settings), 1).content(("linux64",)))
    own = offtrack.run("roundabout", settings={"course.turn_deg": 60.0})
    own.save(tmp_path / "own")
    true = np.asarray(own["off_tracking_true"])
    seconds = 0.01 * (len(true) - 1)
    outputs, sha = run_in_order(ssp, tmp_path / "system", seconds, sys.executable)
    assert trailer.follow_x is not None
    found = off_tracking(outputs, 2, -trailer.follow_x, trailer.roll_axis_height)[: len(true)]
    assert np.nanmax(np.abs(found - true[: len(found)])) < 1e-6
    assert sha == json.loads((tmp_path / "own" / "manifest.json").read_text())["frames_sha256"]
