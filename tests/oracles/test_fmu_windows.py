"""Libraries of FMUs for Windows, run by a C program for Windows under Wine.

It needs the extra ``zig``, and Wine for 64 bits (Debian's package wine64).
"""

from pathlib import Path

import numpy as np
import pytest

from offtrack.exchange.fmi_export.fmu_writer import write_fmu
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from tests.fmus.hosts import HAS_ZIG, Host, host_of_windows, wine
from tests.fmus.plants import START, Slave, deviations, driven_here, weave
from vehicle.combination.description import load_vehicle

pytestmark = [
    pytest.mark.skipif(not HAS_ZIG, reason="needs the extra zig"),
    pytest.mark.skipif(wine() is None, reason="needs Wine for 64 bits"),
]
BOTH = ("linux64", "win64")


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
