"""A part that raises an exception ends its run with an outcome; what was computed until then is kept."""

import errno
import json
import re
import resource
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from controllers.driver import PreviewDriver
from controllers.rover_driver import RoverDriver
from estimators.off_tracking.reference import ReferenceOffTracking
from estimators.slip.rover_odometry import ReferenceSlip
from offtrack.commands.cli import app
from offtrack.reports.run_files import write_run
from offtrack.reports.run_page import report_html, rover_report_html
from scenarios.loop.image_observers import Pictures, StereoPictures
from scenarios.loop.referee import CourseJudge
from scenarios.loop.runner import run
from scenarios.options.scenario import load_any_scenario
from scenarios.results.log import read_log
from scenarios.results.trailer_result import RunResult
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose, ExactSlip, RoverInstruments
from vehicle.combination.plant import Plant
from vehicle.rover.plant import RoverPlant

SHORT = ("course.length=20", "off_tracking=truth", "surface.roughness=none", "reference_unit=false")  # 0.9 s
ROVER = ("course.length=0.5", "surface.slope_from=0", "slip_estimator=truth")

# This file is no library: it counts as the user's own code.
HERE = r" \(tests/offtrack/commands/test_failures\.py, line \d+\)"

Breaker = Callable[[type, str, int, BaseException], None]


@pytest.fixture
def break_after(monkeypatch: pytest.MonkeyPatch) -> Breaker:
    """Make a method raise an exception after some calls."""

    def install(part: type, method: str, calls: int, error: BaseException) -> None:
        whole, made = getattr(part, method), [0]

        def breaking(*arguments: Any) -> Any:
            made[0] += 1
            if made[0] > calls:
                raise error
            return whole(*arguments)

        monkeypatch.setattr(part, method, breaking)

    return install


TRAILER_PARTS = (
    (Plant, "observe", "plant Plant"),
    (Plant, "step", "plant Plant"),
    (ExactPose, "sample", "sensor ExactPose"),
    (ReferenceOffTracking, "step", "estimator ReferenceOffTracking"),
    (CombinationSensors, "sample", "pilot CombinationPilot"),
    (PreviewDriver, "step", "driver.kind = preview"),
    (Pictures, "follow", "observer StereoPictures"),
    (CourseJudge, "outcome", "judge CourseJudge"),
)
ROVER_PARTS = (
    (RoverPlant, "observe", "plant RoverPlant"),
    (ExactSlip, "sample", "sensor ExactSlip"),
    (ReferenceSlip, "step", "estimator ReferenceSlip"),
    (RoverInstruments, "sample", "pilot RoverPilot"),
    (RoverDriver, "step", "driver = path"),
)


@pytest.mark.slow
@pytest.mark.parametrize("calls", [0, 2])
@pytest.mark.parametrize(
    ("part", "method", "named", "scenario"),
    [(*case, ("cambered-road", SHORT)) for case in TRAILER_PARTS]
    + [(*case, ("rover-slope", ROVER)) for case in ROVER_PARTS],
)
def test_an_exception_of_any_part_is_the_outcome_of_its_run(
    part: type, method: str, named: str, scenario: tuple[str, tuple[str, ...]], calls: int, break_after: Breaker
) -> None:
    """In one line with part, time and error; the rows before it are kept, and make a summary and a report."""
    break_after(part, method, calls, ZeroDivisionError("two\nlines"))
    result = run(load_any_scenario(*scenario), 1)
    line = rf"failed: {named}: at tick \d+ \([\d.]+ s\) it raised ZeroDivisionError: two lines{HERE}"
    assert re.fullmatch(line, result.outcome)
    assert "in breaking" in result.traceback
    assert len(result.log) <= 100
    numbers = result.summary()
    assert numbers["outcome"] == result.outcome
    page = report_html(result, numbers) if isinstance(result, RunResult) else rover_report_html(result, numbers)
    assert "it raised ZeroDivisionError: two lines" in page


@pytest.mark.parametrize(
    ("scenario", "part"), [(("cambered-road", SHORT), Plant), (("rover-slope", ROVER), RoverPlant)]
)
@pytest.mark.parametrize("rows", [0, 1, 2])
def test_a_run_that_fails_at_once_leaves_a_whole_directory(
    scenario: tuple[str, tuple[str, ...]], part: type, rows: int, break_after: Breaker, tmp_path: Path
) -> None:
    break_after(part, "observe", rows, RuntimeError("[/] & <b>\ud800"))
    result = run(load_any_scenario(*scenario), 1)
    assert len(result.log) == rows
    directory = write_run(result, tmp_path / "run", video=False)
    names = {"scenario.toml", "manifest.json", "signals.parquet", "summary.json", "report.html", "traceback.txt"}
    assert {path.name for path in directory.iterdir()} == names
    outcome = json.loads((directory / "summary.json").read_text(encoding="utf-8"))["outcome"]
    assert outcome.partition(" (tests")[0].endswith("[/] & <b>?")
    assert "RuntimeError: [/] &amp; &lt;b&gt;?" in (directory / "report.html").read_text(encoding="utf-8")
    assert read_log(directory / "signals.parquet") == result.log


def test_a_run_that_ends_for_lack_of_memory_keeps_its_rows(
    break_after: Breaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if there is not even enough for the line on the part that ran out of it."""

    def misbehaviour(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("scenarios.loop.session.misbehaviour", misbehaviour)
    break_after(Plant, "observe", 20, MemoryError())
    result = run(load_any_scenario("cambered-road", SHORT), 1)
    assert re.fullmatch(r"failed: not enough memory after 0\.\d s", result.outcome)
    assert len(result.log) > 10


def test_too_little_memory_and_an_error_for_lack_of_it_are_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    arguments = ["run", "cambered-road", "--out", str(tmp_path / "a")]
    with monkeypatch.context() as limited:
        limited.setattr(resource, "getrlimit", lambda _: (10**9, 10**9))
        result = CliRunner().invoke(app, arguments)
    line = "offtrack: memory is limited to 1 GB (ulimit -v): a run needs 1.2 GB\n"
    assert (result.exit_code, result.stderr) == (2, line)

    def load(*_: object) -> None:
        raise MemoryError("Unable to allocate 8 GB")

    monkeypatch.setattr("offtrack.commands.run.load_any_scenario", load)
    result = CliRunner().invoke(app, arguments)
    assert (result.exit_code, result.stderr) == (2, "offtrack: not enough memory: Unable to allocate 8 GB\n")
    assert not list(tmp_path.iterdir())


def test_quiet_and_json_say_why_a_study_has_failed(runs_here: None, break_after: Breaker, tmp_path: Path) -> None:
    """Quiet hides progress and tables, never the reason of an exit code."""
    break_after(Plant, "observe", 0, RuntimeError("no luck"))
    settings = [f"--set={setting}" for setting in SHORT]
    for option in ("--quiet", "--json"):
        arguments = ["compare", "cambered-road", *settings, option, "--jobs", "1", "--out", str(tmp_path / "out")]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 1
        assert re.search(r"^offtrack: failed: plant Plant: .*no luck.*: \d+ runs$", result.stderr, re.MULTILINE)


@pytest.mark.parametrize(("video", "debug"), [("--video", ""), ("--no-video", "1")])
def test_the_command_writes_a_failed_run_and_exits_with_1(
    video: str, debug: str, break_after: Breaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line on standard error; the traceback is in its file, and printed only if asked for."""
    break_after(PreviewDriver, "step", 20, SystemExit("bye [/]"))
    monkeypatch.setenv("OFFTRACK_DEBUG", debug)
    settings = [f"--set={setting}" for setting in SHORT]
    result = CliRunner().invoke(app, ["run", "cambered-road", *settings, video, "--out", str(tmp_path / "a")])
    assert result.exit_code == 1
    line = r"offtrack: failed: pilot CombinationPilot: at tick \d+ \(.* s\) it raised SystemExit: bye \[/\]"
    assert re.search(rf"{line}{HERE} \(see {tmp_path}/a/traceback\.txt", result.stderr)
    assert ("Traceback" in result.stderr) == bool(debug)
    assert "in breaking" in (tmp_path / "a" / "traceback.txt").read_text(encoding="utf-8")
    assert "bye [/]" in result.stdout


@pytest.mark.parametrize(
    ("broken", "error", "told"),
    [
        ("run_page.encoded", IndexError("no such colour"), "IndexError: no such colour"),
        (
            "run_files.write_video",
            OSError(errno.ENOSPC, "No space left on device"),
            "No space left on device",
        ),
    ],
)
def test_a_report_that_can_not_be_drawn_does_not_lose_the_run(
    broken: str, error: Exception, told: str, break_after: Breaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaking(*arguments: Any, **options: Any) -> None:
        raise error

    monkeypatch.setattr(f"offtrack.reports.{broken}", breaking)
    break_after(Plant, "observe", 3, RuntimeError("first"))
    result = run(load_any_scenario("cambered-road", SHORT), 1)
    with pytest.raises(ValueError, match=rf"^the (report|video) could not be drawn: {told}; all"):
        write_run(result, tmp_path / "run")
    assert read_log(tmp_path / "run" / "signals.parquet") == result.log
    text = (tmp_path / "run" / "traceback.txt").read_text(encoding="utf-8")
    assert "RuntimeError: first" in text
    assert re.search(told, text)
    assert (tmp_path / "run" / "summary.json").is_file()


@pytest.mark.parametrize(
    ("estimate", "line"),
    [
        (5, "returned 5, not OffTracking or CameraOffTracking"),
        ({"value": "far"}, "returned OffTracking.value = 'far', not float"),
        ({"std": None}, "returned OffTracking.std = None, not float"),
        ({"health": "ok"}, "returned OffTracking.health = 'ok', not Health"),
        ({"tick": 1.5}, "returned OffTracking.tick = 1.5, not int"),
    ],
)
def test_an_estimate_that_is_none_ends_the_run_and_not_its_log(
    estimate: object, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An own estimator may return anything; the log is made after the run, when it is too late."""
    whole = ReferenceOffTracking.step

    def step(self: ReferenceOffTracking, memory: Any, pose: Any) -> tuple[Any, Any]:
        memory, right = whole(self, memory, pose)
        return memory, replace(right, **estimate) if isinstance(estimate, dict) and right else right and estimate

    monkeypatch.setattr(ReferenceOffTracking, "step", step)
    result = run(load_any_scenario("cambered-road", (*SHORT, "trailer_steering=none")), 1)
    assert result.outcome.startswith("failed: estimator ReferenceOffTracking: at tick ")
    assert re.search(f"{re.escape(line)}{HERE}$", result.outcome)
    assert len(result.log) > 5


def test_a_picture_that_is_none_does_not_lose_the_others() -> None:
    """They are compressed while the run goes on, and asked for after its end."""
    jpegs = dict.fromkeys(range(100, 3000, 100), b"jpeg")
    with ThreadPoolExecutor(max_workers=1) as worker:
        pictures: StereoPictures = StereoPictures(0, 1, None, worker, keep=True, recorder=None)
        for tick in range(0, 3000, 100):
            pictures.compress(tick, partial(jpegs.__getitem__, tick))
        assert pictures.frames == list(jpegs.items())


OWN = """
import numpy as np
from controllers.trailer import SteerCommand

class Law:
    def __init__(self, trailer): pass
    def init(self): return None
    def step(self, memory, tick, off_tracking, signals):
        return None, SteerCommand(angles=self.angles())
    def angles(self): return np.zeros(2)

class Needs(Law):
    def __init__(self, trailer, gain): pass  # line 13

class Divides(Law):
    def __init__(self, trailer):
        1 / 0  # line 17

class NoMemory(Law):
    def init(self):
        raise RuntimeError("none today")  # line 21

class Three(Law):
    def step(self, memory, tick, off_tracking, signals):  # line 24
        return None, SteerCommand(angles=np.zeros(3))

class Fails(Law):
    def angles(self):
        return {}["gain"]  # line 29
"""


@pytest.mark.parametrize(
    ("name", "line", "code"),
    [
        ("Needs", "Needs.__init__() missing 1 required positional argument: 'gain' (own_laws.py, line 13)", 2),
        ("Divides", "ZeroDivisionError: division by zero (own_laws.py, line 17)", 2),
        ("NoMemory", "RuntimeError: none today (own_laws.py, line 21)", 2),
        ("Three", "it returned 3 angles, the trailer has 2 steered axles (own_laws.py, line 24)", 1),
        ("Fails", "it raised KeyError: 'gain' (own_laws.py, line 29)", 1),
    ],
)
def test_a_fault_in_a_users_law_is_one_line_with_its_place(
    name: str, line: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_laws.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "own_laws", raising=False)
    monkeypatch.setenv("OFFTRACK_DEBUG", "")
    settings = [f"--set={setting}" for setting in ("off_tracking=truth", f"trailer_steering=own_laws:{name}")]
    arguments = ["run", "roundabout", *settings, "--no-video", "--quiet", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == code
    assert line in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert (tmp_path / "run").exists() == (code == 1)
    if code == 2:
        again = CliRunner().invoke(app, [*arguments, "--debug"])
        assert again.exit_code == 2
        assert "Traceback" in again.stderr
        assert line in again.stderr.splitlines()[-1]
