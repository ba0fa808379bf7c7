"""Studies on a Dask cluster: what is sent to workers, what comes back, and what is refused."""

import json
import logging
import threading
import time
import types
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed")

from offtrack.studies.case import Case, installed
from offtrack.studies.cluster_executor import DaskExecutor, connected, job_queue
from offtrack.studies.cluster_workshop import Workshop, difference, packed
from offtrack.studies.pool import RunOptions, run_cases
from offtrack.studies.study import load_study
from scenarios.processes import SpareWorkers, WorkerDiedError
from tests.in_process import make_runs_here

STUDY = """scenario = "cambered-road"
set.course.length = 20
set.off_tracking = "truth"
set.surface.roughness = "none"
[vary]
speed_kmh = [50, 60]
"""
LAW = """from laws.gains import GAIN
from controllers.trailer_steering.signal_laws import Unsteered

class Mine(Unsteered):
    pass
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.fixture
def scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A cluster whose worker is a thread of this process; its runs are in processes of their own all the same."""
    from distributed import LocalCluster

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        local = {"processes": False, "threads_per_worker": 1, "dashboard_address": None, "protocol": "tcp"}
        with LocalCluster(n_workers=1, local_directory=str(tmp_path / "dask"), host="127.0.0.1", **local) as cluster:
            yield cluster


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_runs_on_a_cluster_are_those_of_the_pool(
    study: Path, tmp_path: Path, scheduler: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bitwise the same; what is there is not made again; a cluster without workers is given up in time."""
    cases, cells = load_study(study).cases(), tmp_path / "dask-runs"
    make_runs_here(monkeypatch)  # of the pool: those of the cluster are in processes of their own
    connect = partial(connected, scheduler.scheduler_address)
    with DaskExecutor(connect, timeout=600.0, patience=0.5, waits=False, remark=print) as executor:
        made = run_cases(cases, cells, RunOptions(jobs=1, executor=executor.results))
        expected = run_cases(cases, tmp_path / "here", RunOptions(jobs=1))
        for one, other in zip(made, expected, strict=True):
            assert one.number("off_tracking.true_rms_m") == other.number("off_tracking.true_rms_m")
            assert one.signals is not None
            assert other.signals is not None
            assert one.signals.read_bytes() == other.signals.read_bytes()
        files = {path: path.stat().st_mtime_ns for path in cells.iterdir()}
        next(cells.glob("*.json")).unlink()
        run_cases(cases, cells, RunOptions(jobs=1, executor=executor.results))
        assert sum(path.stat().st_mtime_ns == before for path, before in files.items()) == 2
        scheduler.scale(0)
        while scheduler.scheduler_info["workers"]:
            time.sleep(0.05)
        (lost, _) = run_cases(cases, tmp_path / "lost", RunOptions(jobs=1, executor=executor.results))
        assert str(lost.numbers["outcome"]) == "failed: no worker was left in the Dask cluster for 0.5 s"
    with (
        DaskExecutor(connect, timeout=None, patience=0.5, waits=False, remark=print) as executor,
        pytest.raises(ValueError, match="has no worker"),
    ):
        run_cases(cases, tmp_path / "none", RunOptions(jobs=1, executor=executor.results))


@pytest.mark.slow
def test_a_worker_without_the_files_gets_them_and_returns_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An own law with what it imports, and a vehicle file; the run is bitwise that of the machine with the files."""
    home = tmp_path / "home"
    (home / "laws").mkdir(parents=True)
    (home / "laws" / "mine.py").write_text(LAW, encoding="utf-8")
    (home / "laws" / "gains.py").write_text("GAIN = 1.0\n", encoding="utf-8")
    shipped = Path(__file__).parents[3] / "vehicle" / "parameters" / "uk_longer_semitrailer.toml"
    (home / "uk_longer_semitrailer.toml").write_bytes(shipped.read_bytes())
    monkeypatch.chdir(home)
    monkeypatch.syspath_prepend(home)
    keys = {"course.length": "20", "off_tracking": "truth", "vehicle": "uk_longer_semitrailer.toml"}
    keys["trailer_steering"] = "laws.mine:Mine"
    case = Case(scenario="cambered-road", fixed=tuple(keys.items()), axes=(), seed=1)
    (expected,) = run_cases([case], tmp_path / "here", RunOptions(jobs=1))
    shipment, (order,) = packed({case.identity(): case})
    assert {Path(name).name for name in shipment.contents} == {"mine.py", "gains.py", "uk_longer_semitrailer.toml"}
    home.rename(tmp_path / "away")  # a machine that has none of it
    monkeypatch.chdir(tmp_path)
    workshop = Workshop(shipment, None)
    workshop.setup(types.SimpleNamespace(local_directory=str(tmp_path)))
    try:
        delivery = workshop.make(order)
    finally:
        workshop.teardown(None)
    assert delivery.problem == ""
    returned = json.loads(delivery.files[f"{order.name}.json"])
    assert returned["signals_sha256"]
    assert returned["off_tracking"] == expected.numbers["off_tracking"]
    assert expected.signals is not None
    assert delivery.files[f"{order.name}.parquet"] == expected.signals.read_bytes()
    assert not list(tmp_path.glob("offtrack-*"))


def test_spare_workers_end_tasks_that_take_too_long_or_kill() -> None:
    """A task that fails leaves its process usable; `stop` ends one that is at work."""
    spare = SpareWorkers()
    with pytest.raises(ValueError, match="invalid literal"):
        spare.call(int, "one")
    assert spare.call(abs, -3) == 3
    with pytest.raises(WorkerDiedError, match=r"took longer than 0\.2 s"):
        spare.call(time.sleep, 60.0, timeout=0.2)
    problems: list[BaseException] = []

    def sleep() -> None:
        try:
            spare.call(time.sleep, 60.0)
        except WorkerDiedError as error:
            problems.append(error)

    thread = threading.Thread(target=sleep)
    thread.start()
    time.sleep(0.5)
    spare.stop()
    thread.join(20.0)
    assert len(problems) == 1


def test_differences_of_software_are_named() -> None:
    """Python, then the first library, then offtrack's own files."""
    sha, (python, libraries) = installed()[0], json.loads(installed()[1])
    assert "numpy 0.1, here is" in difference((sha, json.dumps([python, libraries | {"numpy": "0.1"}])))
    assert "it has Python 2.7" in difference((sha, json.dumps(["2.7 (old)", libraries])))
    assert "files of offtrack" in difference(("another", installed()[1]))


def test_a_wrong_queue_is_one_line(tmp_path: Path) -> None:
    for text, line in (
        ("jobqueue: {slrm: {cores: 1}}", "did you mean 'slurm'"),
        ("jobqueue: [", "not YAML"),
        ("slurm: {cores: 1}", "expected 'jobqueue:'"),
        ("jobqueue: {slurm: 3}", "must be a table"),
    ):
        (tmp_path / "queue.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=line):
            job_queue(tmp_path / "queue.yaml")
