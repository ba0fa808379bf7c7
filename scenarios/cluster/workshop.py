"""A worker's part in a study: it keeps the study's files, and makes runs in processes of its own.

A run is never made in the worker's own process: own modules of another study may be loaded there, OpenGL belongs to one
thread, a run that takes too long could not be ended, and one that crashes would take others with it.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any, Final, NamedTuple

from distributed import WorkerPlugin, get_worker

from scenarios.cluster.shipment import MODULES, Order, Shipment
from scenarios.processes import SpareWorkers
from scenarios.studies.case import Case, identities
from scenarios.studies.pool import is_saved, run_case

PREFIX: Final = "offtrack-"  # of a plugin's name


class Delivery(NamedTuple):
    """Result of a run that a worker returns."""

    problem: str  # of a run that failed; empty for others
    files: dict[str, bytes]  # by name; empty if they are in the study's folder


class Place(NamedTuple):
    """Working directory and search path of modules of a process that makes runs."""

    scratch: Path
    cwd: Path
    search_path: tuple[str, ...]

    def enter(self) -> None:
        """Make this process work here."""
        os.chdir(self.cwd)
        sys.path[:0] = [folder for folder in self.search_path if folder not in sys.path]


class Workshop(WorkerPlugin):  # type: ignore[misc]  # untyped: the extra may not be installed
    """Files of a study, and the processes that make its runs, on one worker."""

    def __init__(self, shipment: Shipment, cells: Path, mark: str, timeout: float | None) -> None:
        """For a study whose runs go to ``cells``; a worker that finds the file ``mark`` there shares the folder."""
        self._shipment, self._cells, self._mark, self._timeout = shipment, cells, mark, timeout
        self.name = f"{PREFIX}{shipment.key}-{mark}"

    def setup(self, worker: Any) -> None:
        """Lay out the files on a worker that begins, or is there already."""
        process: Any = multiprocessing.current_process()
        process._config["daemon"] = False  # a nanny's processes may not have children otherwise
        self._scratch = Path(tempfile.mkdtemp(prefix=self.name, dir=worker.local_directory))
        self._processes = SpareWorkers()
        if self._shipment.is_here():
            self._place = Place(self._scratch, Path(self._shipment.cwd), self._shipment.search_path)
        else:
            self._shipment.lay_out(self._scratch)
            self._place = Place(self._scratch, self._scratch, (str(self._scratch / MODULES),))

    def teardown(self, worker: Any) -> None:
        """End what is running, and remove the files."""
        self._processes.stop()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def make(self, order: Order) -> Delivery:
        """Make a run; one that is in the study's folder already, which this worker shares, is not made again.

        Raises:
            Exception: whatever ended the run, or `WorkerDiedError`.
        """
        if self._place.cwd == self._scratch:
            order = order._replace(scenario=self._shipment.rewritten(order.scenario))
        if (self._cells / self._mark).exists():
            found = is_saved(self._cells, order.name, lambda line: None)
            return Delivery("" if found else self._made(order, self._cells), {})
        with tempfile.TemporaryDirectory(dir=self._scratch) as name:
            problem = self._made(order, Path(name))
            return Delivery(problem, {path.name: path.read_bytes() for path in Path(name).iterdir()})

    def render_problem(self) -> str:
        """One line on what keeps this machine from rendering cameras; empty if nothing does."""
        return self._processes.call(_render_problem)

    def _made(self, order: Order, cells: Path) -> str:
        return self._processes.call(_run, order, self._place, cells, timeout=self._timeout)


def fulfilled(order: Order, plugin: str) -> Delivery:
    """Make a run on this worker; a task of the cluster."""
    delivery: Delivery = get_worker().plugins[plugin].make(order)
    return delivery


def render_problem(plugin: str) -> str:
    """Reason why this worker cannot render cameras; empty if it can. A task of the cluster."""
    problem: str = get_worker().plugins[plugin].render_problem()
    return problem


def _run(order: Order, place: Place, cells: Path) -> str:
    """Make a run in this process; returns its problem, as `run_case`."""
    place.enter()
    file = place.scratch / f"{order.name}.toml"
    file.write_text(order.scenario, encoding="utf-8")
    case = Case(scenario=str(file), fixed=(), axes=(), seed=order.seed)
    try:
        if identities([case], portable=True) != [order.portable]:
            raise ValueError(f"a file, offtrack or a library differs on {platform.node()}: repeat the command")
        return run_case(case, cells, order.name, case.identity())
    finally:
        file.unlink(missing_ok=True)


def _render_problem() -> str:
    from sensors.render import RendererUnavailableError, check_renderer

    try:
        check_renderer()
    except RendererUnavailableError as error:
        return str(error)
    return ""
