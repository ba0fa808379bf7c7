"""Tuning with trials in PostgreSQL, on this machine alone: several commands at once, one of them killed."""

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import optuna
import pytest

pytest.importorskip("psycopg")

from offtrack.studies.trials import database

ROOT: Final = Path(__file__).resolve().parents[2]
USER: Final = "postgres"  # PostgreSQL does not run as root
SHORT: Final = ("course.turn_deg=30", "course.entry=20", "course.exit=5", "speed_kmh=20", "off_tracking=truth")
TRIALS: Final = 12


def programs() -> Path | None:
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    on_path = shutil.which("initdb")
    return found[-1].parent if found else Path(on_path).parent if on_path else None


def as_user(*words: str) -> list[str]:
    return ["runuser", "-u", USER, "--", *words] if os.geteuid() == 0 else list(words)


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = programs()
    if folder is None:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    if os.geteuid() == 0 and USER not in {entry.pw_name for entry in pwd.getpwall()}:
        pytest.skip(f"PostgreSQL does not run as root, and there is no user {USER}")
    home, password = Path("/tmp") / f"offtrack-postgresql-{os.getpid()}", secrets.token_urlsafe(12)
    home.mkdir()
    (home / "password").write_text(password, encoding="utf-8")
    if os.geteuid() == 0:
        for path in (home, home / "password"):
            shutil.chown(path, USER)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        words = ["-D", str(home / "data"), "-U", USER, "-A", "scram-sha-256", f"--pwfile={home / 'password'}"]
        subprocess.run(as_user(str(folder / "initdb"), *words), check=True, capture_output=True, cwd=home)
        options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={home}"
        control = as_user(str(folder / "pg_ctl"), "-D", str(home / "data"), "-w", "-l", str(home / "log"))
        subprocess.run([*control, "-o", options, "start"], check=True, stdout=subprocess.DEVNULL, cwd=home)
        yield f"postgresql://{USER}:{password}@127.0.0.1:{port}/postgres"
        subprocess.run([*control, "-m", "immediate", "stop"], check=False, stdout=subprocess.DEVNULL, cwd=home)
    finally:
        shutil.rmtree(home, ignore_errors=True)


def start(url: str, folder: Path, name: str) -> subprocess.Popen[str]:
    fixed = [word for setting in SHORT for word in ("--set", setting)]
    ranges = ["--range", "gain=0.1:1.0", "--trials", str(TRIALS), "--seeds", "11", "--judge-seeds", "12", "--jobs", "1"]
    return subprocess.Popen(
        [sys.executable, "-m", "offtrack", "tune", "roundabout", *fixed, *ranges, "--quiet", "--out", name],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OFFTRACK_STORAGE": url},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def trials(url: str) -> list[optuna.trial.FrozenTrial]:
    (name,) = optuna.get_all_study_names(database(url))
    found: list[optuna.trial.FrozenTrial] = optuna.load_study(study_name=name, storage=database(url)).trials
    return found


def test_commands_share_the_trials_and_the_killed_ones_are_tried_again(url: str, tmp_path: Path) -> None:
    """Two commands, a third that is killed in a trial; every result is written, no password anywhere."""
    running = [start(url, tmp_path, name) for name in ("one", "two")]
    victim = start(url, tmp_path, "three")
    deadline = time.monotonic() + 300.0
    while not any(t.user_attrs.get("process") for t in _started(url)) and time.monotonic() < deadline:
        time.sleep(0.2)
    time.sleep(3.0)
    os.killpg(victim.pid, signal.SIGKILL)
    victim.communicate()
    for process in running:
        said = process.communicate(timeout=600.0)[0]
        assert process.returncode == 0, said
    done = trials(url)
    states = [trial.state.name for trial in done]
    assert TRIALS <= states.count("COMPLETE") <= TRIALS + 2  # others finish what they had begun
    assert len({trial.user_attrs["process"][1] for trial in done if trial.state.name == "COMPLETE"}) >= 2
    with start(url, tmp_path, "three") as again:  # it goes on: nothing is left to do but to judge
        assert again.communicate(timeout=600.0)[0] == ""
    assert "RUNNING" not in [trial.state.name for trial in trials(url)]
    tuned = {(tmp_path / name / "tuned.toml").read_text(encoding="utf-8") for name in ("one", "two", "three")}
    assert len(tuned) <= 2  # a last trial may have come between
    password = url.split(":")[2].split("@")[0]
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and password.encode() in path.read_bytes()]


def test_a_wrong_password_is_one_line(url: str, tmp_path: Path) -> None:
    process = start(url.replace("@", "wr0ng@"), tmp_path, "out")
    said = process.communicate(timeout=120.0)[0]
    assert process.returncode == 2
    assert "the database can not be used" in said
    assert "password authentication failed" in said
    assert len(said.splitlines()) == 1
    assert url.split(":")[2].split("@")[0] not in said


def _started(url: str) -> list[optuna.trial.FrozenTrial]:
    try:
        return trials(url)
    except ValueError:  # no table yet
        return []
