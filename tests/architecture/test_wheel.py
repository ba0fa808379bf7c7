"""Content of `pip install`: the wheel, built as it is for a release."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")


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
