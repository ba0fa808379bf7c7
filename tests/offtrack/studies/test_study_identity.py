"""A saved run stands for its case only as long as nothing that it depends on has changed."""

import json
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from offtrack.studies import case as identity
from offtrack.studies.case import Case
from offtrack.studies.cluster_workshop import shipment
from offtrack.studies.pool import RunOptions, run_cases
from offtrack.studies.study import settings_of
from scenarios.options.scenario import RoverScenario, Scenario, load_any_scenario
from scenarios.results.run_inputs import own_modules
from tests.vehicle.ground.test_property_files import TEXT, on_files
from vehicle.combination.description import load_vehicle
from vehicle.foundation.quantity import tables_in

SHORT = (("course.length", "20"), ("off_tracking", "truth"), ("surface.roughness", "none"))
LAW = """
from pathlib import Path

import numpy
from controllers.trailer import SteerCommand

class Law:
    def __init__(self, trailer): self.axles = sum(trailer.steered)
    def init(self): return None
    def step(self, memory, *rest):
        from parts import angle  # inside a function
        wheels = numpy.full(self.axles, angle.ANGLE * float(Path("scale.txt").read_text()))
        return None, SteerCommand(angles=wheels)
"""


def text_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """All keys of a scenario that take a text; a part's parameter in the place of a table of them."""
    for name, info in model.model_fields.items():
        tables = tables_in(info.annotation)
        for table in tables:
            yield from text_keys(table, f"{prefix}{name}.")
        if "dict" in str(info.annotation):
            yield f"{prefix}{name}.table"
        elif not tables and "str" in str(info.annotation):
            yield f"{prefix}{name}"


def identity_of(scenario: str, *settings: str) -> str:
    return Case(scenario=scenario, fixed=settings_of(settings, "--set"), axes=(), seed=1).identity()


@pytest.fixture(autouse=True)
def _own_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))


@pytest.mark.parametrize(("scenario", "model"), [("roundabout", Scenario), ("rover-slope", RoverScenario)])
def test_every_option_that_can_name_a_file_changes_the_identity_with_its_content(
    scenario: str, model: type[BaseModel], tmp_path: Path
) -> None:
    """Of all parts, found in the models: a new option is covered without a line. Its time and place do not count."""
    found = set()
    for key in text_keys(model):
        file, copy = tmp_path / "file.toml", tmp_path / "copy.toml"
        file.write_text("content = 1\n")
        try:
            load_any_scenario(scenario, [f"{key}={file}"])
        except ValueError:
            continue  # a name from a short list
        first = identity_of(scenario, f"{key}={file}")
        os.utime(file, (1, 1))
        shutil.copy(file, copy)
        assert identity_of(scenario, f"{key}={file}") == identity_of(scenario, f"{key}={copy}") == first
        file.write_text("content = 2\n")
        assert identity_of(scenario, f"{key}={file}") != first, key
        found.add(key)
    known = {
        "roundabout": {"vehicle", "driver.trace", "policy.path", "surface.friction_image", "steering.table"},
        "rover-slope": {"vehicle", "surface.soil", "surface.height_map", "driving.table", "sensing.table"},
    }
    assert known[scenario] <= found


def test_an_own_module_counts_with_all_that_it_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative import in a package, from within a function; not installed libraries, nor files it does not import."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "__init__.py").touch()
    (tmp_path / "parts" / "angle.py").write_text("from ._base import ANGLE\n")
    (tmp_path / "parts" / "_base.py").write_text("ANGLE = 0.1\n")
    (tmp_path / "other.py").touch()
    (tmp_path / "own_law_1.py").write_text(LAW)
    assert set(own_modules("own_law_1")) == {"own_law_1", "parts", "parts.angle", "parts._base"}
    settings = ("trailer_steering=own_law_1:Law",)
    first = identity_of("roundabout", *settings)
    (tmp_path / "other.py").write_text("CHANGED = True\n")
    assert identity_of("roundabout", *settings) == first
    for name in ("parts/_base.py", "parts/__init__.py", "own_law_1.py"):
        before = identity_of("roundabout", *settings)
        (tmp_path / name).write_text((tmp_path / name).read_text() + "# changed\n")
        assert identity_of("roundabout", *settings) != before, name
    before = identity_of("roundabout", *settings)
    shutil.copytree(tmp_path, tmp_path / "copy")  # its runs need not be repeated
    monkeypatch.chdir(tmp_path / "copy")
    sys.path.remove(str(tmp_path))
    assert identity_of("roundabout", *settings) == before


@pytest.fixture
def read_again() -> Iterator[None]:
    yield
    identity.installed.cache_clear()


@pytest.mark.usefixtures("read_again")
def test_offtracks_own_files_and_the_engine_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An editable checkout changes without its version; a README changes no number."""
    (tmp_path / "vehicle").mkdir()
    source, readme = tmp_path / "vehicle" / "plant.py", tmp_path / "vehicle" / "README.md"
    monkeypatch.setattr(identity, "package_folders", lambda: (tmp_path / "vehicle",))
    found = []
    for file, content in ((source, "a"), (readme, "text"), (source, "b")):
        file.write_text(content)
        identity.installed.cache_clear()
        found.append(identity.software())
    assert found[0] == found[1] != found[2]
    monkeypatch.setattr(identity, "compiler", lambda: None)
    assert identity.software() != found[2]
    assert identity.identity("", 1) != identity.identity("", 2)


@pytest.mark.slow
def test_files_that_a_law_opens_by_itself_count_too(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No option names them: the run tells which files it has opened, and is repeated when one of them changes."""
    here, elsewhere = tmp_path_factory.mktemp("study"), tmp_path_factory.mktemp("tables")
    scales = [folder / "scale.txt" for folder in (here, elsewhere)]
    monkeypatch.chdir(here)
    (here / "parts.py").write_text("class angle:\n    ANGLE = 0.05\n")
    read = " + ".join(f'float(Path("{file}").read_text())' for file in scales)
    (here / "own_law_3.py").write_text(LAW.replace('float(Path("scale.txt").read_text())', f"({read})"))
    (here / "my.toml").write_text(load_any_scenario("cambered-road").to_toml())
    case = Case(scenario="my.toml", fixed=(*SHORT, ("trailer_steering", "own_law_3:Law")), axes=(), seed=1)
    steer = []
    for numbers in (("0", "0"), ("0", "0"), ("0", "1"), ("1", "1")):
        for file, number in zip(scales, numbers, strict=True):
            file.write_text(number)
        with (here / "my.toml").open("a") as file_of_scenario:
            file_of_scenario.write("# a comment changes no number\n")
        before = {file: file.stat().st_mtime_ns for file in here.glob("cells/*")}
        (outcome,) = run_cases([case], here / "cells", RunOptions(jobs=1))
        steer.append(outcome.number("steer.max_deg"))
        kept = before and before == {file: file.stat().st_mtime_ns for file in here.glob("cells/*")}
        assert bool(kept) == (len(steer) == 2)
    for file in here.glob("cells/*.json"):
        assert [Path(name).name for name in json.loads(file.read_text())["files_sha256"]] == ["scale.txt"] * 2
    assert steer[0] == steer[1] == 0.0
    assert steer[2] == pytest.approx(2.865, abs=0.05)  # 0.05 rad, which the actuators approach
    assert steer[3] == pytest.approx(5.730, abs=0.10)


def test_files_opened_are_told_from_those_that_are_named_or_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of another run's law stays; one of another run's option, and a log, do not."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(identity, "_unnamed", {})
    for name in ("table.txt", "option.txt", "second.txt"):
        (tmp_path / name).write_text("1")
    monkeypatch.setattr(identity, "_own_files", set())  # as if another process had written them
    identity.watch_files()
    (tmp_path / "table.txt").read_text()
    (tmp_path / "option.txt").read_text()
    (tmp_path / "log.txt").write_text("written")
    (tmp_path / "log.txt").read_text()
    first = identity.opened_files({tmp_path / "option.txt"})
    assert [Path(name).name for name in first] == ["table.txt"]
    identity.watch_files()
    (tmp_path / "second.txt").read_text()
    second = identity.opened_files(set())
    assert {Path(name).name for name in second} == {"table.txt", "second.txt"}
    (tmp_path / "table.txt").write_text("2")
    os.utime(tmp_path / "table.txt", (1, 1))
    with pytest.raises(ValueError, match=r"table\.txt has changed while the study ran"):
        identity.opened_files(set())


def test_the_tyre_file_of_a_vehicle_counts_and_goes_to_workers(tmp_path: Path) -> None:
    """Its content is a part of the identity; a worker finds the copy by the name in the copy of the vehicle's file."""
    on_files(tmp_path, TEXT["61"])
    file = str(tmp_path / "truck.toml")
    before = identity_of("roundabout", f"vehicle={file}", "trailer_steering=none")
    sent = shipment([file])
    for name, content in sent.contents.items():
        (tmp_path / "worker" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "worker" / name).write_bytes(content)
    there = load_vehicle(str(tmp_path / "worker" / sent.names[file]))
    assert there == load_vehicle(file)
    on_files(tmp_path, TEXT["61"].replace("PDY1 = 0.84", "PDY1 = 0.85"))
    assert identity_of("roundabout", f"vehicle={file}", "trailer_steering=none") != before
