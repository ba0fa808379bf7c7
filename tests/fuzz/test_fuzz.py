"""A short, always equal run of the fuzz suite, and that the suite notices what it looks for."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.fuzz.case import LARGEST, SLOWEST, Case, Result, find
from tests.fuzz.draw import drawn
from tests.fuzz.drawn_campaigns import campaigns
from tests.fuzz.drawn_environments import environment_uses
from tests.fuzz.drawn_scenarios import every_key, keys_of_listing, scenario_runs, studies
from tests.fuzz.files import FILES, hostile_files
from tests.fuzz.mutations import FORMATS, hostile
from tests.fuzz.pool import Tried, try_all
from tests.fuzz.specimens import make
from vehicle.foundation.user_file import FileKind

_SEED = 8
_SLOW = ("study", "run", "training")  # specimens that take seconds to make


def tried(cases: Iterable[Case], folder: Path, hang: float = 60.0) -> list[Tried]:
    """All cases tried, in one child: another takes seconds of processor time to start."""
    results: list[Tried] = []
    try_all(cases, folder / "cases", folder / "specimens", children=1, report=results.append, hang=hang)
    return results


@pytest.mark.slow
def test_random_scenarios_studies_campaigns_environments_and_hostile_files_end_well(tmp_path: Path) -> None:
    files = [read for read in FILES if read.specimen not in _SLOW]
    make(tmp_path / "specimens", {read.specimen for read in files})
    cases = [case for read in files for case in drawn(hostile_files(read, tmp_path / "specimens"), 1, _SEED)]
    cases += drawn(scenario_runs(), 3, _SEED) + drawn(studies(), 1, _SEED) + drawn(campaigns(), 2, _SEED)
    cases += drawn(environment_uses(), 2, _SEED)
    quick = [case for case in cases if "cameras" not in case.kind]
    results = tried(quick, tmp_path)
    assert len(results) == len(quick) > 25
    assert [f"{one.wrong}: {one.case.title()}\n{one.result.error}" for one in results if one.wrong is not None] == []


def test_every_kind_of_file_has_hostile_versions() -> None:
    assert set(FileKind) <= {read.kind for read in FILES}


def test_every_format_of_files_has_its_own_mutations() -> None:
    assert {read.format for read in FILES} == set(FORMATS)
    notes = {note for _, note in drawn(hostile(b"a = 1\n[b]\nc = [2.0, 3.0]\n", "toml"), 60, _SEED)}
    assert any("set to" in note for note in notes)
    assert any("bits flipped" in note for note in notes)
    assert any("in its place" in note for note in notes)


def test_every_key_of_the_listing_is_drawn() -> None:
    assert keys_of_listing() <= every_key()


def test_equal_seeds_draw_equal_cases() -> None:
    assert drawn(scenario_runs(), 5, 3) == drawn(scenario_runs(), 5, 3)
    assert drawn(scenario_runs(), 5, 3) != drawn(scenario_runs(), 5, 4)


@pytest.mark.slow
def test_errors_deaths_hangs_and_traces_of_refusals_are_finds(tmp_path: Path) -> None:
    scripts = {
        "raise RuntimeError('planted')": "RuntimeError: planted",
        "raise ValueError('a\\nb')": "2 lines for a refusal",
        "open('x', 'w').close()\nraise ValueError('no')": "a refusal wrote x",
        "import os\nos._exit(3)": "its process died twice, at last by exit code 3",
        "import os\nos.mkfifo('f')\nopen('f')": "took longer than 15 s",
        "raise ValueError('no')": None,
        "from gymnasium.error import ClosedEnvironmentError\nraise ClosedEnvironmentError('no')": None,
        "outcome = 'completed'": None,
    }
    results = tried([Case(kind="planted", script=script) for script in scripts], tmp_path, hang=15.0)
    wrong = {one.case.script: one.wrong for one in results}
    for script, expected in scripts.items():
        found = wrong[script]
        assert found is None if expected is None else found is not None and found.startswith(expected), script


@pytest.mark.parametrize(
    ("result", "says"),
    [
        (Result(code=0, memory=2 * LARGEST), "MB of memory"),
        (Result(code=2, err="no\n", seconds=2 * SLOWEST), "a refusal took"),
        (Result(code=2, err=""), "0 lines"),
        (Result(code=1, err="Aborted!\n"), "exit code 1"),
        (Result(code=0, out="Traceback (most recent call last):\nKeyError"), "KeyError"),
        (Result(code=0, outcome="failed: KeyError: 'x'"), "failed: KeyError"),
        (Result(code=70, error="Traceback\nTypeError: x"), "TypeError: x"),
    ],
)
def test_a_result_is_judged(result: Result, says: str) -> None:
    assert says in (find(result, {}, {}) or "")
