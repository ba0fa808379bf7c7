"""The command as a user meets it: what it prints, how it refuses, what it leaves behind."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

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


@pytest.mark.slow
def test_missing_opengl_is_refused_in_one_line_before_anything_moves(tmp_path: Path) -> None:
    """EGL that can not be loaded looks to PyOpenGL like a machine without it; the line says what to install."""
    (tmp_path / "OpenGL").mkdir()
    (tmp_path / "OpenGL" / "__init__.py").write_text(
        "raise ImportError('Unable to load EGL library')", encoding="utf-8"
    )
    bare = ["--set", "world.scenery_density=0", "--quiet"]
    done = offtrack("run", "constant-slip", *bare, cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "apt-get install" in done.stderr
    assert "off_tracking=truth" in done.stderr
    assert not (tmp_path / "runs").exists()


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
    assert "--set" in invoked("run", "--help").stdout
    listed = invoked("scenarios").stdout
    for name in ("roundabout", "roundabout-right", "figure-of-eight", "constant-slip"):
        assert name in listed


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
        assert invoked(name, "--help").exit_code == 0
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
