"""A Dask worker that does not fit, in a process of its own, is refused in one line, before any run."""

import logging
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
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


@pytest.mark.filterwarnings("ignore")
def test_a_worker_with_other_files_is_refused(address: Any, tmp_path: Path) -> None:
    """An update that was forgotten on one machine; other versions: tests/offtrack/studies/test_cluster.py."""
    site, out = tmp_path / "site", tmp_path / "out"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, site / package, ignore=shutil.ignore_patterns("__pycache__"))
    with (site / "controllers" / "driver.py").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    worker = subprocess.Popen(
        [*command, "--no-dashboard", "--local-directory", str(tmp_path / "worker")],
        env=os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
    )
    command = [sys.executable, "-m", "offtrack", "sweep", "study.toml", "--scheduler", address, "--out", str(out)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run([*command, "--quiet"], env=environment, capture_output=True, text=True, cwd=tmp_path)
    worker.kill()
    worker.wait()
    assert ended.returncode == 2, ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1, ended.stderr
    assert "its files of offtrack differ from those here" in ended.stderr
    assert ended.stderr.startswith("offtrack: worker tcp://127.0.0.1:")
    assert not [*out.glob("cells/*.json")]
