"""Files and modules that the runs of a study need on other machines.

Every run is sent as the text of its resolved scenario. The files that scenarios name, and the user's own modules with
all that they import, are sent once to each worker. A worker that has the same files at the same paths uses those.

Files that own code opens by itself cannot be known in advance: they must be at their paths on the workers.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import tomli_w

from scenarios.results.file_names import MAP_SUFFIX, is_file, texts, with_texts
from scenarios.results.files import digest
from scenarios.results.run_inputs import named_modules
from scenarios.studies.case import Case, identities

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
    contents = {name: Path(path).read_bytes() for path, name in names.items()}
    return Shipment(cwd=os.getcwd(), search_path=_own_folders(), names=names, contents=contents)


def _with_vehicles(named: Iterable[str], files: Iterable[str]) -> Iterator[str]:
    """The texts, and those of all TOML files among them: a vehicle may name an own tyre law."""
    yield from named
    for path in files:
        if path.endswith(".toml"):
            try:
                yield from texts(tomllib.loads(Path(path).read_text(encoding="utf-8")))
            except ValueError:
                continue  # the run says what is wrong with it


def _own_folders() -> tuple[str, ...]:
    """Folders on the search path of modules, without Python's own."""
    return tuple(folder for folder in sys.path if folder and not Path(folder).is_relative_to(sys.base_prefix))
