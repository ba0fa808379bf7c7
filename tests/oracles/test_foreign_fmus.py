"""FMUs that OpenModelica and PythonFMU3 exported, as steering laws and sources of off-tracking of a run.

The FMUs are in the package gemseo-fmu (LGPL), which is needed for nothing else: ``pip install --no-deps gemseo-fmu``.
"""

import importlib.util
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import offtrack
from controllers.trailer import Combination, SteerCommand
from estimators.estimates import OffTracking
from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import law_of, signals_of
from offtrack.exchange.fmi_import.mapping import first_map, map_file, read_map
from scenarios.assembly.adapters import trailer_geometry
from sensors.messages import CombinationSignals
from tests.fmus.proxies import reading
from vehicle.combination.description import load_vehicle

_PACKAGE = importlib.util.find_spec("gemseo_fmu")
pytestmark = pytest.mark.skipif(_PACKAGE is None, reason="needs the package gemseo-fmu")
VEHICLE = "uk_longer_semitrailer_one_steered"
SETTINGS: dict[str, object] = {"vehicle": VEHICLE, "off_tracking": "truth"}
SETTINGS |= {"course.turn_deg": 30.0, "course.entry": 20.0, "course.exit": 5.0}


def fmu(name: str, text: str, folder: Path) -> str:
    assert _PACKAGE is not None
    assert _PACKAGE.origin is not None
    file = Path(_PACKAGE.origin).parent / "problems" / "fmu_files" / "linux" / name
    copy = Path(shutil.copy(file, folder / name))
    copy.with_name(f"{name}.toml").write_text(text, encoding="utf-8")
    return str(copy)


class Sum:
    def __init__(self, trailer: object) -> None:
        """For any trailer."""

    def init(self) -> None:
        """Nothing to remember."""

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        e, direction = (off_tracking.value, off_tracking.hitch_direction) if off_tracking else (0.0, 0.0)
        return memory, SteerCommand(angles=np.full(len(signals.angles), 0.2 * (e + direction)))


def test_a_sum_of_openmodelica_steers_as_the_same_law_in_python(tmp_path: Path) -> None:
    file = fmu(
        "add.fmu",
        'period = 0.02\n[inputs]\nu1 = "off_tracking"\nu2 = "hitch_direction"\n'
        '[outputs]\ny = { signal = "steer_demand_1", factor = 0.2 }\n',
        tmp_path,
    )
    own = offtrack.run("roundabout", settings=SETTINGS | {"trailer_steering": f"{__name__}:Sum"})
    other = offtrack.run("roundabout", settings=SETTINGS | {"trailer_steering": file})
    for name in ("off_tracking_true", "steer_trailer_1_command", "x_semitrailer"):
        np.testing.assert_allclose(other[name], own[name], atol=1e-12)
    assert np.nanmax(np.abs(np.asarray(own["steer_trailer_1_command"]))) > 0.01


def test_a_damped_mass_of_openmodelica_swings_as_in_fmpy(tmp_path: Path) -> None:
    """A law with a state of its own, pushed by a constant off-tracking."""
    law = 'period = 0.02\n[inputs]\nf = { signal = "speed", unit = "m/s", factor = 0.1 }\n'
    file = fmu("Mass_Damper.fmu", law + '[outputs]\ny = "steer_demand_1"\n', tmp_path)
    vehicle = load_vehicle(VEHICLE)
    steering = law_of(file)(trailer_geometry(vehicle, 1), combination=Combination(vehicle, 1))
    memory, swing = steering.init(), []
    for tick in range(0, 10_000, 20):
        memory, command = steering.step(memory, tick, None, reading(0, 3.0, axles=1))
        swing.append(float(command.angles[0]))
    times: Any = {"stop_time": 10.0, "step_size": 0.02, "output_interval": 0.02}
    alone = simulate_fmu(file, **times, start_values={"f": 0.3}, output=["y"], fmi_type="CoSimulation")
    assert np.ptp(swing) > 0.01
    np.testing.assert_allclose(swing, alone["y"][1:501], atol=1e-9)


def test_a_ramp_of_openmodelica_alone_is_no_source_of_off_tracking(tmp_path: Path) -> None:
    """A source must say whether it knows the off-tracking."""
    text = 'period = 0.01\n[outputs]\nout = { signal = "off_tracking", factor = 0.01 }\n'
    with pytest.raises(ValueError, match="off_tracking_known"):
        offtrack.run("roundabout", settings=SETTINGS | {"off_tracking": fmu("ramp.fmu", text, tmp_path)})


def test_a_model_of_pythonfmu3_steers(tmp_path: Path) -> None:
    text = 'period = 0.02\n[inputs]\ninput = "off_tracking"\n[outputs]\noutput = "steer_demand_1"\n'
    file = fmu("FMU3Model.fmu", text, tmp_path)
    run = offtrack.run("roundabout", settings=SETTINGS | {"trailer_steering": file})
    assert run.summary["outcome"] == "completed"


@pytest.mark.parametrize("part", ["trailer_steering", "plant"])
def test_a_first_map_is_written_for_every_one(part: str, tmp_path: Path) -> None:
    """It can be read; what is missing for the part is said in one line."""
    assert _PACKAGE is not None
    assert _PACKAGE.origin is not None
    vehicle = load_vehicle(VEHICLE)
    files = sorted((Path(_PACKAGE.origin).parent / "problems" / "fmu_files" / "linux").glob("*.fmu"))
    assert len(files) == 7
    for file in files:
        opened, signals = open_fmu(Path(shutil.copy(file, tmp_path / file.name))), signals_of(part, vehicle)
        map_file(opened.path).write_text(first_map(opened, signals), encoding="utf-8")
        with pytest.raises(ValueError, match=r"no variable is connected to .*: write them into"):
            read_map(opened, signals)
