"""Dask workers that do not fit, in processes of their own: each is refused in one line, before any run."""

import logging
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

pytest.importorskip("distributed")

from tests.offtrack.studies.test_cluster import STUDY

ROOT: Final = Path(__file__).resolve().parents[2]
PACKAGES: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")


@pytest.fixture
def address() -> Iterator[str]:
    from distributed import LocalCluster

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with LocalCluster(n_workers=0, processes=False, dashboard_address=None, protocol="tcp", host="127.0.0.1") as c:
            yield c.scheduler_address


@contextmanager
def worker(address: str, home: Path, first: Path) -> Iterator[None]:
    """A worker's process, for which modules and versions in the folder ``first`` come before all others."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    home.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [*command, "--no-dashboard", "--local-directory", str(home)],
        env=os.environ | {"PYTHONPATH": f"{first}{os.pathsep}{ROOT}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=home,
    )
    try:
        yield
    finally:
        process.kill()
        process.wait()


def refused(address: str, tmp_path: Path) -> str:
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(STUDY, encoding="utf-8")
    command = [sys.executable, "-m", "offtrack", "sweep", str(study), "--scheduler", address, "--out", str(out)]
    ended = subprocess.run(
        [*command, "--quiet"], env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, cwd=tmp_path
    )
    assert ended.returncode == 2, ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1, ended.stderr
    assert not [*out.glob("cells/*.json")]
    return ended.stderr


@pytest.mark.filterwarnings("ignore")
def test_a_worker_with_other_files_is_refused(address: Any, tmp_path: Path) -> None:
    """An update that was forgotten on one machine; other versions: tests/offtrack/studies/test_cluster.py."""
    site = tmp_path / "site"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, site / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (site / "controllers" / "driver.py").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    with worker(address, tmp_path / "worker", site):
        line = refused(address, tmp_path)
    assert "its files of offtrack differ from those here" in line
    assert line.startswith("offtrack: worker tcp://127.0.0.1:")
