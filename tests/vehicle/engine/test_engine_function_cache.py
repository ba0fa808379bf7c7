"""Derived equations are kept between processes, and what is read is always what would be derived."""

from pathlib import Path
from typing import Any

import casadi as ca
import pytest

from vehicle.combination.description import Vehicle
from vehicle.combination.functions import step_function, topology
from vehicle.engine import function_cache
from vehicle.engine.function_cache import Composite, derived_once
from vehicle.engine.program import program_of
from vehicle.foundation.user_cache import sources_hash, warn_once
from vehicle.tyres.laws import BrushTyre


class Derivation:
    def __init__(self, function: Any = None) -> None:
        x = ca.SX.sym("x", 2)
        self.function = ca.Function("square", [x, ca.SX(0, 1), ca.SX(0, 1)], [x**2]) if function is None else function
        self.calls = 0

    def __call__(self) -> Any:
        self.calls += 1
        return self.function


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    warn_once.cache_clear()
    return tmp_path / "cache"


def kept(folder: Path) -> list[Path]:
    return list(folder.iterdir())


def test_the_equations_that_are_read_are_those_that_were_derived(
    folder: Path, tractor_semitrailer: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All operations are the same ones in the same order, so that runs are bitwise the same."""
    step, bare = step_function(tractor_semitrailer), topology(tractor_semitrailer)
    assert isinstance(step, Composite)
    derive = Derivation(step)
    assert derived_once("step", (bare,), derive) is step
    read = derived_once("step", (bare,), derive)
    assert derive.calls == 1
    assert isinstance(read, Composite)
    assert read is not step
    assert [call[1:] for call in read.calls] == [call[1:] for call in step.calls]
    assert program_of(read) == program_of(step)


def test_each_name_description_source_and_version_has_its_own(
    folder: Path, tractor_semitrailer: Vehicle, longer_semitrailer: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that a function is derived from is in its key: nothing derived from something else can be read."""
    derive = Derivation()
    bare, with_inputs = topology(tractor_semitrailer), topology(tractor_semitrailer.with_torque_inputs())
    for name, described in (
        ("step", (bare,)),
        ("wheels", (bare,)),
        ("step", (topology(longer_semitrailer),)),
        ("step", (with_inputs,)),
        ("step", (bare, None)),
    ):
        derived_once(name, described, derive)
    monkeypatch.setattr(function_cache, "SOURCES", "of a later version")
    derived_once("step", (bare,), derive)
    monkeypatch.setattr(function_cache, "VERSIONS", ("a later CasADi",))
    derived_once("step", (bare,), derive)
    assert derive.calls == len(kept(folder)) == 7


def test_the_sources_of_the_package_are_hashed(tmp_path: Path) -> None:
    """A changed, added or renamed module changes the hash; without sources there is none, and nothing is cached."""
    hashes = [sources_hash(tmp_path)]
    module = tmp_path / "tyres" / "law.py"
    module.parent.mkdir()
    for change in (
        lambda: module.write_text("GRIP = 1.0"),
        lambda: module.write_text("GRIP = 0.9"),
        lambda: (tmp_path / "chain.py").write_text(""),
        lambda: module.rename(tmp_path / "tyres" / "other.py"),
    ):
        change()
        hashes.append(sources_hash(tmp_path))
    assert hashes[0] == ""
    assert len(set(hashes)) == 5


@pytest.mark.parametrize("foreign", [False, True])
def test_what_is_not_in_the_hash_of_the_sources_is_not_cached(
    folder: Path, tractor_semitrailer: Vehicle, monkeypatch: pytest.MonkeyPatch, foreign: bool
) -> None:
    """A tyre law from elsewhere, or all if there are no sources: nothing would tell two versions from each other."""

    class Foreign(BrushTyre):
        """A law of which nothing is known."""

    vehicle = topology(tractor_semitrailer)
    if foreign:
        unit = tractor_semitrailer.units[0]
        axle = unit.axles[0].model_copy(update={"tyre": Foreign.model_construct(**vars(unit.axles[0].tyre))})
        changed = unit.model_copy(update={"axles": (axle, *unit.axles[1:])})
        vehicle = tractor_semitrailer.model_copy(update={"units": (changed, *tractor_semitrailer.units[1:])})
    else:
        monkeypatch.setattr(function_cache, "SOURCES", "")
    derive = Derivation()
    for _ in range(2):
        derived_once("step", (vehicle,), derive)
    assert derive.calls == 2
    assert not folder.exists()


@pytest.mark.parametrize("end", [0, -40])
def test_a_damaged_file_is_made_anew(
    folder: Path, tractor_semitrailer: Vehicle, caplog: pytest.LogCaptureFixture, end: int
) -> None:
    derive, bare = Derivation(), topology(tractor_semitrailer)
    derived_once("step", (bare,), derive)
    (path,) = kept(folder)
    path.write_bytes(path.read_bytes()[:end])
    for _ in range(2):
        function: Any = derived_once("step", (bare,), derive)
        assert function([1.0, 3.0], [], []).full().ravel().tolist() == [1.0, 9.0]
    assert derive.calls == 2
    (warning,) = caplog.messages
    assert f"{path} is damaged" in warning
