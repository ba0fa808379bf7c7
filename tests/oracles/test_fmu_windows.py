"""Libraries of FMUs for Windows, run by a C program for Windows under Wine.

It needs the extra ``zig``, and Wine for 64 bits (Debian's package wine64).
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from offtrack.exchange.fmi_export.fmu_writer import fmu_bytes, write_fmu
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from offtrack.exchange.fmi_proxy.law_proxy import law_proxy
from tests.fmus.hosts import HAS_ZIG, Host, compiled_for_windows, host_of_windows, wine
from tests.fmus.plants import START, Slave, deviations, driven_here, weave
from vehicle.combination.description import load_vehicle

pytestmark = [
    pytest.mark.skipif(not HAS_ZIG, reason="needs the extra zig"),
    pytest.mark.skipif(wine() is None, reason="needs Wine for 64 bits"),
]
BOTH = ("linux64", "win64")
LINUX_ONLY = "offtrack runs on Linux only"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("windows")


@pytest.fixture(scope="module")
def host(place: Path) -> Host:
    return host_of_windows(place, place / "wine")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["eu_tractor_semitrailer", "b_double_steered"])
def test_a_truck_weaves_on_windows_as_the_plant_here(host: Host, name: str, version: int, tmp_path: Path) -> None:
    """20 s, everything that ``Truth`` has; sines and roots of another C library round otherwise."""
    fmu, vehicle, drive = tmp_path / "truck.fmu", load_vehicle(name), weave(20.0)
    write_fmu(fmu, plant_model(name, None, wind=False), version, BOTH)
    slave = Slave(fmu, tmp_path / "x")
    outputs, names = slave.outputs, set(slave.reference)
    slave.close()
    rows = {"steer": drive.steer, "acceleration": drive.acceleration}
    rows |= {f"steer_trailer_{k}": drive.trailer for k in range(1, 10) if f"steer_trailer_{k}" in names}
    done = host.run(fmu, tmp_path / "x", rows=rows, outputs=outputs, starts=START)
    assert done.returncode == 0, done.stderr
    found = dict(zip(outputs, np.loadtxt(done.stdout.splitlines()).T, strict=True))
    worst = deviations(driven_here(vehicle, drive), found)
    assert worst.pop("wheel_load") < 1e-5  # N, of some 1e5
    assert max(worst.values()) < 1e-9


@pytest.mark.parametrize("version", [2, 3])
def test_a_wrong_step_on_windows_is_refused_with_a_message(host: Host, version: int, tmp_path: Path) -> None:
    fmu = tmp_path / "truck.fmu"
    write_fmu(fmu, plant_model("rigid_truck", None, wind=False), version, BOTH, optimisation=1)
    done = host.run(fmu, tmp_path / "x", rows={"gear": [1.0, 0.5]}, outputs=["x_1"])
    assert done.returncode == 1
    assert "gear = 0.5 must be 1 (forward) or -1 (backward)" in done.stderr


def law(folder: Path, version: int) -> Path:
    fmu = folder / "law.fmu"
    proxy = law_proxy("command_steer", load_vehicle("uk_longer_semitrailer"), {})
    fmu.write_bytes(fmu_bytes(proxy.exported(version), version, BOTH))
    return fmu


@pytest.mark.parametrize("version", [2, 3])
def test_a_law_on_windows_says_that_offtrack_needs_linux(host: Host, version: int, tmp_path: Path) -> None:
    done = host.run(law(tmp_path, version), tmp_path / "x", rows={"speed": [1.0]}, outputs=["steer_demand_1"])
    assert done.returncode == 1
    (line, _) = done.stderr.splitlines()
    assert line.startswith("start: its Python process failed: 'python' cannot be started: error 2 of Windows; ")
    assert LINUX_ONLY in line


@pytest.mark.parametrize(
    ("mishap", "line"),
    [
        ("", ""),
        ("exit", "at 0.01 s: its Python process failed: it exited with code 5 (it said: the battery is empty)"),
        ("stall", "at 0.01 s: its Python process failed: it does not answer within 0.5 s"),
        ("refuse", "at 0.01 s: its Python process failed: the road ends here"),
    ],
)
def test_the_process_of_a_law_on_windows(place: Path, mishap: str, line: str, tmp_path: Path) -> None:
    """Another program takes Python's place: it starts, steps, fails with its last words, and ends with the host."""
    program = compiled_for_windows(Path(__file__).parents[1] / "fmus" / "stand_in.c", place)
    host = host_of_windows(place, place / "wine", MISHAP=mishap)
    done = host.run(
        law(tmp_path, 3),
        tmp_path / "x",
        rows={"speed": [1.0, 2.0, 3.0]},
        outputs=["steer_demand_1", "steer_demand_2"],
        starts={"timeout": 0.5},
        texts={"python": f"Z:{program}"},
    )
    values = np.loadtxt(done.stdout.splitlines(), ndmin=2)
    assert values[1, 0] == 10.0
    assert values[1, 1] > 0.0
    if line:
        assert done.returncode == 1
        assert done.stderr.startswith(line)
    else:
        assert (done.returncode, done.stderr) == (0, "")
        assert values[:, 0].tolist() == [0.0, 10.0, 20.0, 30.0]
        assert len(set(values[1:, 1])) == 1  # one process
    said = subprocess.run(["pgrep", "-f", str(program)], capture_output=True, text=True, check=False)
    assert said.stdout == ""  # none goes on
