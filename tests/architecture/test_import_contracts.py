"""The house's walls: every import contract holds, and each one fails when it is broken."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")
LINT = Path(sys.executable).with_name("lint-imports")


def lint(directory: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(LINT), "--config", "pyproject.toml", "--no-cache"],
        cwd=directory,
        env={"PYTHONPATH": str(directory), "PATH": ""},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def house(tmp_path: Path) -> Path:
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


@pytest.mark.slow
def test_every_contract_holds(house: Path) -> None:
    result = lint(house)
    assert result.returncode == 0, result.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("vehicle/frames.py", "import sensors.messages", "The rooms form a chain"),
        ("sensors/messages.py", "import estimators.estimates", "The rooms form a chain"),
        ("estimators/estimates.py", "import controllers.trailer", "The rooms form a chain"),
        ("controllers/trailer.py", "import scenarios.options.scenario", "The rooms form a chain"),
        ("estimators/estimates.py", "import vehicle.combination.truth", "never see the truth"),
        ("controllers/trailer.py", "import vehicle.combination.plant", "never see the truth"),
        ("controllers/trailer.py", "import sensors.camera", "never images"),
        ("controllers/trailer.py", "import cv2", "never images"),
        ("sensors/messages.py", "import pyrender", "only in sensors.render"),
        ("offtrack/commands/cli.py", "import OpenGL", "only in sensors.render"),
        ("estimators/estimates.py", "import matplotlib", "only in scenarios and offtrack"),
        ("vehicle/frames.py", "import typer", "only in scenarios and offtrack"),
        ("scenarios/options/base.py", "import offtrack.reports.page", "The rooms form a chain"),
        ("scenarios/results/log.py", "import scenarios.loop.session", "Floors of scenarios"),
        ("offtrack/reports/page.py", "import offtrack.exchange.drawings", "Floors of offtrack"),
        ("offtrack/studies/study.py", "import offtrack.commands.run", "Floors of offtrack"),
        ("offtrack/reports/page.py", "import offtrack.studies.study", "No import circles"),
        ("vehicle/tyres/laws.py", "import vehicle.combination.chain", "No import circles"),
    ],
)
def test_a_broken_contract_is_noticed(house: Path, module: str, line: str, contract: str) -> None:
    path = house / module
    path.write_text(path.read_text(encoding="utf-8") + f"\n{line}\n", encoding="utf-8")
    result = lint(house)
    assert result.returncode == 1, result.stdout
    broken = [row for row in result.stdout.splitlines() if "BROKEN" in row]
    assert any(contract in row for row in broken), result.stdout


# The wheel


def test_every_data_file_reaches_the_wheel(tmp_path: Path) -> None:
    """Whatever lies in the packages beside modules: parameters, scenarios, the surrogate, networks, shaders."""
    reason = "hatchling is not installed: pip install 'offtrack[dev]'"
    builder = pytest.importorskip("hatchling.builders.wheel", reason=reason).WheelBuilder(str(ROOT))
    (built,) = builder.build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(built) as wheel:
        there = set(wheel.namelist())
    kept = {
        str(file.relative_to(ROOT))
        for package in PACKAGES
        for file in (ROOT / package).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts and not file.name.startswith(".")
    }
    assert "scenarios/assembly/surrogate.toml" in kept
    assert {"offtrack/reports/templates/page.html.j2", "offtrack/reports/numbers.toml"} <= kept
    assert "controllers/trailer_steering/networks/trailer_steering_v0.npz" in kept
    assert kept - there == set()
