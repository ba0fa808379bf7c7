"""A cluster worker's part in a study: files sent to it, checks before the first run, and runs in own processes.

Every run is sent as the text of its resolved scenario. The files that scenarios name, and the user's own modules with
all that they import, are sent once to each worker. A worker that has the same files at the same paths uses those.

Files that own code opens by itself cannot be known in advance: they must be at their paths on the workers.

A run is never made in the worker's own process: own modules of another study may be loaded there, OpenGL belongs to one
thread, a run that takes too long could not be ended, and one that crashes would take others with it.
"""

import hashlib
import json
import multiprocessing
import os
import platform
import shutil
import sys
import tempfile
import tomllib
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import tomli_w
from distributed import WorkerPlugin, get_worker

from offtrack.studies.case import Case, identities, installed
from offtrack.studies.pool import run_case
from scenarios.processes import SpareWorkers
from scenarios.results.run_directory import digest
from scenarios.results.run_inputs import (
    MAP_SUFFIX,
    is_file,
    named_modules,
    renamed_tyres,
    texts,
    tyre_files,
    with_texts,
)
from vehicle.foundation.user_file import read_toml, shown

if TYPE_CHECKING:
    from distributed import Client


MODULES: Final = "modules"  # folder of the own modules among the files
_LARGEST: Final = 256_000_000  # of all files together [bytes]


class Order(NamedTuple):
    """A run that a worker is to make."""

    name: str
    scenario: str  # TOML; names files by their paths on the client
    seed: int
    portable: str  # identity, apart from the machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Shipment:
    """Files of a study as they are on the client."""

    cwd: str
    search_path: tuple[str, ...]  # of modules
    names: Mapping[str, str] = field(default_factory=dict)  # on the worker, relative; by the path on the client
    contents: Mapping[str, bytes] = field(default_factory=dict)  # by the name on the worker

    @property
    def key(self) -> str:
        """Hash of all files and where they were."""
        sha = hashlib.sha256(repr((self.cwd, self.search_path, sorted(self.names.items()))).encode())
        for name in sorted(self.contents):
            sha.update(name.encode() + hashlib.sha256(self.contents[name]).digest())
        return sha.hexdigest()[:16]

    def is_here(self) -> bool:
        """True if this machine has the same files at the same paths."""
        return os.path.isdir(self.cwd) and all(
            digest(Path(path)) == hashlib.sha256(self.contents[name]).hexdigest() for path, name in self.names.items()
        )

    def lay_out(self, folder: Path) -> None:
        """Write all files below a folder."""
        for name, content in self.contents.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    def rewritten(self, scenario: str) -> str:
        """A scenario that names the files by their names on the worker."""
        return tomli_w.dumps(with_texts(tomllib.loads(scenario), lambda text: self.names.get(text, text)))


def packed(cases: Mapping[str, Case]) -> tuple[Shipment, list[Order]]:
    """The files of these runs, and an order for each; ``cases`` by name.

    Raises:
        ValueError: one line, if the files are too large to be sent.
    """
    resolved: dict[tuple[str, tuple[str, ...]], str] = {}
    named = set[str]()
    for case in cases.values():
        key = case.scenario, case.settings
        if key not in resolved:
            scenario = case.resolved()
            resolved[key] = scenario.to_toml()
            named |= set(texts(scenario.model_dump(exclude_none=True)))
    portable = identities(list(cases.values()), portable=True)
    orders = [
        Order(name, resolved[case.scenario, case.settings], case.seed, identity)
        for (name, case), identity in zip(cases.items(), portable, strict=True)
    ]
    return shipment(sorted(named)), orders


def shipment(named: Sequence[str]) -> Shipment:
    """All that texts of scenarios name: files, and own modules, also those that vehicle files name.

    Raises:
        ValueError: one line, if the files are too large to be sent.
    """
    files = [text for text in named if os.path.isabs(text) and is_file(text)]
    files += sorted({tyre for path in files for tyre in tyre_files(path).values() if is_file(tyre)})
    names: dict[str, str] = {}
    for path in files:
        names[path] = f"{digest(Path(path))[:16]}/{Path(path).name}"
        if path.endswith(".fmu") and is_file(path + MAP_SUFFIX):
            names[path + MAP_SUFFIX] = names[path] + MAP_SUFFIX
    modules = {name: file for text in _with_vehicles(named, files) for name, file in named_modules(text).items()}
    for name, file in modules.items():
        parts = name.split(".") if file.stem == "__init__" else name.split(".")[:-1]
        names[str(file)] = "/".join((MODULES, *parts, file.name))
    size = sum(os.path.getsize(path) for path in names)
    if size > _LARGEST:
        largest = max(names, key=os.path.getsize)
        raise ValueError(
            f"the study's files have {size / 1e6:.0f} MB, the largest is {largest}: at most {_LARGEST / 1e6:.0f} MB "
            "are sent to workers"
        )
    contents = {name: renamed_tyres(path, Path(path).read_bytes(), names) for path, name in names.items()}
    return Shipment(cwd=os.getcwd(), search_path=_own_folders(), names=names, contents=contents)


def _with_vehicles(named: Iterable[str], files: Iterable[str]) -> Iterator[str]:
    """The texts, and those of all TOML files among them: a vehicle may name an own tyre law."""
    yield from named
    for path in files:
        if path.endswith(".toml"):
            try:
                yield from texts(read_toml(Path(path)))
            except ValueError:
                continue  # the run says what is wrong with it


def _own_folders() -> tuple[str, ...]:
    """Folders on the search path of modules, without Python's own."""
    return tuple(folder for folder in sys.path if folder and not Path(folder).is_relative_to(sys.base_prefix))


PREFIX: Final = "offtrack-"  # of a plugin's name


class Delivery(NamedTuple):
    """Result of a run that a worker returns."""

    problem: str  # of a run that failed; empty for others
    files: dict[str, bytes]  # by name


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

    def __init__(self, shipment: Shipment, timeout: float | None) -> None:
        self._shipment, self._timeout = shipment, timeout
        self.name = f"{PREFIX}{shipment.key}-{uuid.uuid4().hex[:12]}"

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
        """Make a run.

        Raises:
            Exception: whatever ended the run, or `WorkerDiedError`.
        """
        if self._place.cwd == self._scratch:
            order = order._replace(scenario=self._shipment.rewritten(order.scenario))
        with tempfile.TemporaryDirectory(dir=self._scratch) as name:
            problem = self._processes.call(_run, order, self._place, Path(name), timeout=self._timeout)
            return Delivery(problem, {path.name: path.read_bytes() for path in Path(name).iterdir()})


def fulfilled(order: Order, plugin: str) -> Delivery:
    """Make a run on this worker; a task of the cluster."""
    delivery: Delivery = get_worker().plugins[plugin].make(order)
    return delivery


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


_SAME: Final = "the same is needed everywhere"


def check_software(client: "Client") -> None:
    """Refuse workers with another offtrack, Python or other libraries than here; lost ones do not count.

    Raises:
        ValueError: one line, with the first difference.
    """
    try:
        found: Mapping[str, Any] = client.run(installed, on_error="return")
    except Exception as error:  # whatever the import of another version leads to
        raise ValueError(f"the workers have another offtrack: {shown(str(error).splitlines()[0])}") from None
    for worker, software in found.items():
        if software != installed() and not isinstance(software, OSError):
            raise ValueError(f"worker {worker}: {difference(software)}; {_SAME}")


def difference(software: Any) -> str:
    """The first difference of a worker's software from that of this process."""
    if not isinstance(software, tuple):
        return f"its offtrack does not work ({shown(str(software))})"
    known = (json.loads(versions) for versions in (installed()[1], software[1]))
    here, there = ({"Python": python.split()[0], **libraries} for python, libraries in known)
    for name in sorted(here.keys() | there.keys()):
        if here.get(name) != there.get(name):
            return f"it has {name} {there.get(name, '(none)')}, here is {here.get(name, '(none)')}"
    return "its files of offtrack differ from those here"
