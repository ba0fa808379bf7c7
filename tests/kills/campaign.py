"""Commands that are killed at some moment, and started again: nothing may be lost, left behind or in the way."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import optuna
import pyarrow.parquet as pq
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 600.0  # with a command that hangs [s]
ORPHANS_END = 5.0  # time for all processes to end after the first one [s]

_SHORT = ("course.length=40", "off_tracking=truth", "surface.roughness=none", "reference_unit=false")
_TURN = ("course.turn_deg=30", "course.entry=20", "course.exit=5", "speed_kmh=20", "off_tracking=truth")
_SMALL = ("rig.width=320", "rig.height=200", "world.scenery_density=0", "world.overcast=true")
STUDY = """scenario = "cambered-road"
seeds = [1, 2]
[set]
"course.length" = 40
off_tracking = "truth"
"surface.roughness" = "none"
[vary]
trailer_steering = ["none", "command_steer"]
"""


def _set(*settings: str) -> list[str]:
    return [part for setting in settings for part in ("--set", setting)]


COMMANDS = {
    "run": ["run", "cambered-road", *_set("course.length=600", *_SHORT[1:]), "--no-video", "--out", "out"],
    "run --record": ["run", "turn-90", *_set(*_TURN, *_SMALL), "--no-video", "--record", "rec", "--out", "out"],
    "compare": ["compare", "cambered-road", *_set(*_SHORT), "--seeds", "1-2", "--jobs", "2", "--out", "out"],
    "sweep": ["sweep", "study.toml", "--jobs", "2", "--out", "out"],
    "tune": ["tune", "roundabout", *_set(*_TURN), "--seeds", "11", "--judge-seeds", "12", "--range", "gain=0.1:1.0",
             "--trials", "3", "--jobs", "2", "--out", "out"],
    "estimate": ["estimate", "off-tracking", "images", "--no-video", "--out", "out"],
    "reproduce": ["reproduce", "reina2008-fig6", "--quick", "--out", "out"],
    "train": ["train", "--steps", "40000", "--envs", "8", "--episodes", "1", "--out", "out"],
}  # fmt: skip
RECORDING = ["run", "turn-90", *_set(*_TURN, *_SMALL), "--no-video", "--record", "images", "--out", "images_run"]
SIGNALS = (signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGHUP)


def start(command: list[str], folder: Path) -> subprocess.Popen[str]:
    """Start a command in a group of processes of its own; it heeds Ctrl-C even if this process does not."""
    return subprocess.Popen(
        [sys.executable, "-m", "offtrack", *command, "--quiet"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler) and None,
    )


def killed(
    command: str, number: signal.Signals, folder: Path, is_due: Callable[[], bool]
) -> tuple[int, int, list[str]]:
    """Kill a command when it is time, and start it again.

    Returns its exit code, the units that it had finished, and what is wrong.
    """
    main = start(COMMANDS[command], folder)
    deadline = time.monotonic() + PATIENCE
    while main.poll() is None and not is_due() and time.monotonic() < deadline:
        time.sleep(0.01)
    main.send_signal(number)
    problems = []
    try:
        said = main.communicate(timeout=60.0)[1]
    except subprocess.TimeoutExpired:
        main.kill()
        said = main.communicate()[1]
        problems.append("did not end within 60 s")
    if main.returncode not in (0, 128 + number, -number):
        problems.append(f"exit code {main.returncode}")
    if main.returncode != -number and ("Traceback" in said or len(said.strip().splitlines()) > 1):
        problems.append(f"said {said.strip()[-300:]!r}")
    deadline = time.monotonic() + ORPHANS_END
    while (left := [*_processes(main.pid)]) and time.monotonic() < deadline:
        time.sleep(0.1)
    for process in left:
        os.kill(process, signal.SIGKILL)
    problems += [f"{len(left)} processes left after {ORPHANS_END:g} s"] if left else []
    units = finished_units(folder)
    problems += damaged(folder)
    if main.returncode != 0 and not _is_complete(folder):
        again = start(COMMANDS[command], folder)
        said = again.communicate(timeout=PATIENCE)[1]
        if again.returncode != 0:
            problems.append(f"the next one ends with {again.returncode}: {said.strip()[-300:]}")
        after = finished_units(folder)
        problems += [f"{name} is lost or was repeated" for name, saved in units.items() if after.get(name) != saved]
        problems += damaged(folder)
        problems += [f"{path.name} is left over" for path in folder.rglob(".*.unfinished")]
    return main.returncode, len(units), problems


def _processes(group: int) -> Iterator[int]:
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, its_group = path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[:3]
            if its_group == str(group) and state != "Z":
                yield int(path.parent.name)


def finished_units(folder: Path) -> dict[str, int]:
    """Saved runs of studies and finished trials, with the time at which they were saved."""
    cells = {path.name: path.stat().st_mtime_ns for path in folder.glob("out/cells/*.json")}
    journal = folder / "out" / "journal.log"
    if not journal.is_file() or not journal.stat().st_size:
        return cells
    storage = JournalStorage(JournalFileBackend(str(journal)))
    studies = [optuna.load_study(study_name=name, storage=storage) for name in optuna.get_all_study_names(storage)]
    trials = [trial for study in studies for trial in study.get_trials(states=(TrialState.COMPLETE,))]
    return cells | {
        f"trial {one.number}": int(one.datetime_complete.timestamp()) for one in trials if one.datetime_complete
    }


def damaged(folder: Path) -> list[str]:
    found = []
    for path in folder.glob("[!.]*/**/*"):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        try:
            if path.suffix == ".json":
                json.loads(path.read_text(encoding="utf-8"))
            elif path.suffix == ".parquet":
                pq.read_table(path)
            elif path.suffix == ".html" and not path.read_text(encoding="utf-8").rstrip().endswith("</html>"):
                found.append(f"{path.name} is cut off")
        except (ValueError, OSError) as error:
            found.append(f"{path.name} is damaged: {error}")
    for times in folder.glob("[!.]*/times.txt"):
        counts = {len(list(times.parent.glob(f"image_{side}/*.png"))) for side in (0, 1)}
        if counts != {len(times.read_text(encoding="utf-8").split())}:
            found.append(f"{times.parent.name}: {counts} images and another number of times")
    return found


def _is_complete(folder: Path) -> bool:
    """True if a result that is made as a whole is there: it was killed when all was done."""
    out = folder / "out"
    names = ("summary.json", "manifest.json", "reina2008-fig6.json")
    return any((out / name).is_file() for name in names) and not (out / ".interrupted").exists()
