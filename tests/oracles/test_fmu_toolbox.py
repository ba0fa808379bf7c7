"""Exports in fmu-manipulation-toolbox: its check, and a container of driver and truck that it makes, run by FMPy.

The package is needed for nothing else: ``pip install fmu-manipulation-toolbox``.
"""

import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

import offtrack
from offtrack.exchange.fmi_export.fmu_writer import fmu_bytes
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from offtrack.exchange.fmi_export.plant_model import Exported, exported_plant
from offtrack.exchange.fmi_proxy.parts import driver_proxy, ground_proxy, law_proxy, sensor_proxy
from offtrack.exchange.fmi_proxy.system import fmu_system
from scenarios.options.scenario import load_scenario
from vehicle.combination.description import load_vehicle

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("fmu_manipulation_toolbox") is None, reason="needs fmu-manipulation-toolbox"
)
VEHICLE = "eu_tractor_semitrailer"
SETTINGS = {"vehicle": VEHICLE, "off_tracking": "truth", "trailer_steering": "none", "course.turn_deg": 30.0}


def tool(name: str, *arguments: str) -> str:
    command = [sys.executable, "-m", f"fmu_manipulation_toolbox.cli.{name}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def exported(name: str, version: int) -> Exported:
    scenario = load_scenario("roundabout", ["off_tracking=truth"])
    exports: dict[str, Callable[[], Exported]] = {
        "truck": lambda: exported_plant(plant_model("rigid_truck", None, wind=False), version),
        "rover": lambda: exported_plant(plant_model("el_dorado_ii", "beach_sand", wind=False), version),
        "law": lambda: law_proxy("path_preview", load_vehicle("uk_longer_semitrailer"), {}).exported(version),
        "sensor": lambda: sensor_proxy(scenario, 1).exported(version),
        "driver": lambda: driver_proxy(scenario).exported(version),
        "ground": lambda: ground_proxy(scenario, 1).exported(version),
    }
    return exports[name]()


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["truck", "rover", "law", "sensor", "driver", "ground"])
def test_fmutool_finds_every_export_compliant(name: str, version: int, tmp_path: Path) -> None:
    fmu = tmp_path / "export.fmu"
    fmu.write_bytes(fmu_bytes(exported(name, version), version, ("linux64",), optimisation=0))
    said = tool("fmutool", "-input", str(fmu), "-check")
    assert f"This FMU seems to be compliant with FMI-{version}.0" in said
    assert f"No semantic error against the FMI-{version} standard" in said or version == 2
    assert not re.search(r"ERROR|WARNING", said), said


def test_a_container_of_driver_and_truck_drives_the_course(tmp_path: Path) -> None:
    """A step late, as in any runner that passes values on at the end of a step: some centimetres."""
    loop = fmu_system(load_scenario("roundabout", [f"{key}={value}" for key, value in SETTINGS.items()]), 1)
    for name in ("plant", "driver"):
        (tmp_path / f"{name}.fmu").write_bytes(fmu_bytes(loop.components[name], 2, ("linux64",)))
    links = [one for one in loop.connections if {one.source, one.target} == {"plant", "driver"}]
    rows = ["rule;from_fmu;from_port;to_fmu;to_port", "FMU;plant.fmu;;;", "FMU;driver.fmu;;;"]
    rows += [f"LINK;{one.source}.fmu;{one.output};{one.target}.fmu;{one.input}" for one in links]
    rows += [f"OUTPUT;plant.fmu;{name};;{name}" for name in ("x_1", "y_1", "psi_1", "psi_2")]
    (tmp_path / "loop.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    tool("fmucontainer", "-fmu-directory", str(tmp_path), "-container", "loop.csv:0.01")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OFFTRACK_PYTHON", sys.executable)
        found = simulate_fmu(
            str(tmp_path / "loop.fmu"), stop_time=15.0, step_size=0.01, output_interval=0.01, validate=False,
            fmi_type="CoSimulation",
        )  # fmt: skip
    own = offtrack.run("roundabout", settings=SETTINGS)
    n = min(len(found), len(own["x_tractor"])) - 1
    away = np.hypot(found["x_1"][1 : n + 1] - own["x_tractor"][:n], found["y_1"][1 : n + 1] - own["y_tractor"][:n])
    assert n > 1000
    assert away.max() < 0.1
