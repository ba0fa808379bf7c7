"""The command as a user meets it: what it prints, how it refuses, what it leaves behind."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner, Result

from offtrack.commands.cli import app

OFFTRACK = str(Path(sys.executable).with_name("offtrack"))
SETTINGS = ["off_tracking=truth", "course.entry=20", "course.turn_deg=30", "course.exit=5"]
QUICK = [*(part for setting in SETTINGS for part in ("--set", setting)), "--no-video"]


def offtrack(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """The installed command in a process of its own, which takes seconds to start."""
    return subprocess.run(
        [OFFTRACK, *arguments],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))  # the catalogue adds the working directory
    return tmp_path


def invoked(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


SHORT = "--set course.entry=20 --set course.turn_deg=30 --set course.exit=5 --quiet"
NOT_RENDERED = (
    *(f"run roundabout {SHORT} --no-video --set off_tracking={name} --out {name}" for name in ("truth", "surrogate")),
    f"compare roundabout {SHORT} --controllers none --off-tracking kinematic",
    "compare truth surrogate --quiet",
    "view truth surrogate --quiet",
    "export truth --quiet",
    "assess eu_tractor_semitrailer --manoeuvres turn --quiet",
    "vehicle eu_tractor_semitrailer --quiet",
    "estimate off-tracking recorded --quiet",
    "run rover-slope --set course.length=0.5 --set slip_estimator=truth --no-video --quiet",
    "doctor",
)
RENDERED = (
    "run constant-slip",
    "compare roundabout --off-tracking viso_ot --quiet",
    "doctor --render",
)
CALLED = """import json, sys
from typer.testing import CliRunner
from offtrack.commands.cli import app
done = [CliRunner().invoke(app, line.split()) for line in sys.argv[1:]]
print(json.dumps([[one.exit_code, one.stdout, one.stderr] for one in done]))
"""


def called_without_opengl(here: Path, *lines: str) -> list[tuple[int, str, str]]:
    """Exit code, output and errors of commands; the loader finds OpenGL's libraries, and cannot load them."""
    (folder := here / "libraries").mkdir()
    for name in ("libEGL.so.1", "libEGL.so", "libGL.so.1", "libGL.so", "libOpenGL.so.0"):
        (folder / name).touch()
    environment = {**os.environ, "LD_LIBRARY_PATH": str(folder)}
    command = [sys.executable, "-c", CALLED, *lines]
    shown = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=True)
    return [(code, output, errors) for code, output, errors in json.loads(shown.stdout.splitlines()[-1])]


@pytest.mark.slow
def test_without_opengl_all_commands_run_that_do_not_render(here: Path) -> None:
    """Other sources of the off-tracking, studies of them, pages, recordings and standards need no picture."""
    tiny = ("course.length=20", "rig.width=128", "rig.height=64", "world.scenery_density=0")
    settings = (part for setting in tiny for part in ("--set", setting))
    assert invoked("run", "constant-slip", *settings, "--no-video", "--quiet", "--record", "recorded").exit_code == 0
    done = called_without_opengl(here, *NOT_RENDERED)
    assert [(line, one) for line, one in zip(NOT_RENDERED, done, strict=True) if one[0] != 0] == []
    assert re.search(r"^cameras +not available", done[-1][1], re.M)


@pytest.mark.slow
def test_without_opengl_what_renders_is_refused_before_anything_is_written(here: Path) -> None:
    """One line, which says what to install and how to go on."""
    for line, (code, _, errors) in zip(RENDERED, called_without_opengl(here, *RENDERED), strict=True):
        assert (line, code, len(errors.strip().splitlines())) == (line, 2, 1), errors
        for words in ("apt-get install libegl1 libgl1", "offtrack doctor", "off_tracking=truth"):
            assert words in errors
    assert {path.name for path in here.iterdir()} <= {"libraries", "runs"}
    assert not list(here.glob("runs/*"))


@pytest.mark.slow
def test_a_run_leaves_a_complete_directory_and_runs_again_identically(here: Path) -> None:
    """The resolved scenario in the run directory is a scenario file: run with it, the signals are bitwise the same.

    Also from one process to another.
    """
    first = offtrack("run", "roundabout", *QUICK, "--json", cwd=here)
    assert first.returncode == 0, first.stderr
    directory = here / "runs" / "roundabout-1"
    assert {path.name for path in directory.iterdir()} == {
        "manifest.json",
        "report.html",
        "scenario.toml",
        "signals.parquet",
        "summary.json",
    }
    assert json.loads(first.stdout) == json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    again = invoked("run", str(directory / "scenario.toml"), "--no-video", "--quiet", "--out", "again")
    assert again.exit_code == 0, again.stderr
    hashes = [json.loads((d / "manifest.json").read_text(encoding="utf-8")) for d in (directory, here / "again")]
    assert hashes[0]["signals_sha256"] == hashes[1]["signals_sha256"]


@pytest.mark.slow
def test_a_run_of_a_doubtful_vehicle_says_so(here: Path) -> None:
    """A load behind the axles lifts the coupling: the vehicle is driven, and the doubt printed, written and shown."""
    change = ("--set", "plant.units.semitrailer.cg_x=-9.5")
    done = invoked("run", "roundabout", *QUICK, *change, "--out", "doubtful")
    assert done.exit_code == 0, done.stderr
    (warning,) = json.loads((here / "doubtful" / "summary.json").read_text(encoding="utf-8"))["warnings"]
    assert warning.startswith("units.1 (semitrailer): its front hitch pulls up with ")
    assert f"Warning: {warning}" in done.stdout
    assert warning in (here / "doubtful" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_controller_of_ones_own_runs_by_its_import_path(here: Path) -> None:
    """A file in the working directory is enough; its own parameters are set like any other key."""
    (here / "mine.py").write_text(
        """
import numpy as np
from controllers.trailer import SteerCommand

class Proportional:
    def __init__(self, trailer, *, gain=0.2): self.gain = gain
    def init(self): return None
    def step(self, memory, tick, off_tracking, steer):
        angle = np.clip(self.gain * off_tracking.value if off_tracking else 0.0, -0.5, 0.5)
        return memory, SteerCommand(angles=np.full(len(steer.angles), angle))
""",
        encoding="utf-8",
    )
    law = ["--set", "trailer_steering=mine:Proportional", "--set", "steering.gain=0.4"]
    runs = (invoked("run", "roundabout", *QUICK, *more, "--json") for more in (law, ["--set", "trailer_steering=none"]))
    steered, unsteered = (json.loads(done.stdout)["off_tracking"]["true_max_m"] for done in runs)
    assert steered < 0.8 * unsteered


def test_help_tells_a_newcomer_what_to_do_next() -> None:
    assert "offtrack run roundabout" in " ".join(invoked("--help").stdout.split())
    assert "figure-of-eight" in invoked("scenarios").stdout


def helps(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Words of a command and of all commands below it."""
    yield words
    for name, inner in getattr(command, "commands", {}).items():
        yield from helps(inner, (*words, name))


@pytest.mark.parametrize("words", list(helps(typer.main.get_command(app))), ids=" ".join)
def test_no_help_wraps_into_a_narrow_column_on_a_terminal_of_80(words: tuple[str, ...]) -> None:
    """A column of text has 30 characters or more, no text is cut, and units in brackets stay."""
    shown = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"})
    assert shown.exit_code == 0
    text = shown.stdout.partition("  Example")[0]  # examples are lines to copy
    for line in text.splitlines():
        inner = line.strip(" │╭╰─╮╯")
        assert len(line) <= 80
        assert line.find(inner) <= 80 - 30, line
        assert not inner.endswith(("...", "…")) or "[ARGS]..." in inner or "}..." in inner, line
    assert not re.search(r"\w \.(?!\w)", text)


def test_the_list_of_commands_needs_none_of_their_libraries() -> None:
    """`offtrack --help` and `--version` are shown at once: a command's module is imported when it is called."""
    code = "import sys\nfrom offtrack.commands.cli import main\ntry:\n    main()\nfinally:\n    print(*sys.modules)"
    for option in ("--help", "--version"):
        command = [sys.executable, "-c", code, option]
        shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
        loaded = set(shown.splitlines()[-1].split())
        assert not {"matplotlib", "pyarrow", "casadi", "scipy", "cv2", "pydantic"} & loaded


def test_every_command_of_the_list_can_be_called() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]  # a group has them
    listed = dict(re.findall(r"^  ([a-z-]+) +([A-Z].*)", invoked("--help").stdout.partition("Commands:")[2], re.M))
    assert list(listed) == list(commands)
    for name, line in listed.items():
        assert commands[name].name in (name, "")
        assert (commands[name].help or "").split()[0] == line.split()[0], name


@pytest.mark.parametrize(
    ("words", "place", "expected"),
    [
        ("offtrack sc", 1, "scenarios"),
        ("offtrack run roundabout-l", 2, "roundabout-low-friction"),
        ("offtrack compare roundabout --set wind.sp", 4, "wind.speed="),
        ("offtrack run roundabout --set off_tracking = ki", 6, "kinematic"),  # as bash cuts it
        ("offtrack run roundabout --set rig.facing = d", 6, "down"),
    ],
)
def test_a_shell_completes_commands_scenarios_keys_and_values(
    words: str, place: int, expected: str, here: Path
) -> None:
    asked = {"_OFFTRACK_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(place)}
    assert offtrack(cwd=here, **asked).stdout.split() == [expected]


def test_doctor_says_what_is_missing_and_what_mends_it(here: Path) -> None:
    """Every extra of users is in the list, and a compiler or a device that does not work is no error of the command."""
    broken = offtrack("doctor", cwd=here, OFFTRACK_EGL_DEVICE="99", OFFTRACK_COMPILER="nix", COLUMNS="300")
    assert broken.returncode == 0, broken.stderr
    for words in ("EGL has no such device", "apt-get install libegl1", "nix is no C compiler", "apt-get install gcc"):
        assert words in broken.stdout
    extras = re.findall(r"^extra (\w+) ", broken.stdout, re.MULTILINE)
    assert {"video", "cad", "rl", "export"} <= set(extras)
    assert not {"dev", "docs", "oracles"} & set(extras)


@pytest.mark.slow
def test_doctor_times_a_pair_on_every_device_and_says_which_one_runs_use(here: Path) -> None:
    """A device that EGL does not have is refused in one line, after the list."""
    good = offtrack("doctor", "--render", cwd=here, OFFTRACK_EGL_DEVICE="0", COLUMNS="120")
    assert good.returncode == 0
    assert re.search(r"software .* \d+\.\d .* \d+\.\d ", good.stdout)
    assert "EGL device 0 (" in good.stdout
    bad = offtrack("doctor", "--render", cwd=here, OFFTRACK_EGL_DEVICE="99")
    assert bad.returncode == 2
    assert "OFFTRACK_EGL_DEVICE=99: EGL has no such device; there are: 0 (" in bad.stderr
