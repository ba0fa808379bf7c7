"""One run of a study: a scenario with settings and a seed, its identity, its summary, and where it was made.

The identity is a hash of everything that the numbers of a run depend on: the resolved scenario with its seed, the
content of every file that any of its values names, the user's own modules with all that they import, offtrack's files,
the versions of libraries, and the engine. Names of folders and modification times do not count.

Files that a run opens although its scenario does not name them, such as a table that an own law reads, are noticed when
they are opened: see ``opened_files``.
"""

import hashlib
import importlib.metadata
import itertools
import json
import math
import os
import platform
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from offtrack.hidden import package_folders
from scenarios.options.scenario import RoverScenario, Scenario, load_any_scenario
from scenarios.results.run_directory import digest
from scenarios.results.run_inputs import is_file, is_import_path, named_modules, texts, tyre_files
from scenarios.results.run_summary import number_at
from vehicle.engine.compiler import compiler, engine_name
from vehicle.foundation.own_parts import is_library
from vehicle.foundation.user_file import FileKind, read_toml, shown

_SYSTEM: Final = (
    *("/proc", "/sys", "/dev", "/run", "/etc", "/usr", "/lib", "/var", "/opt", "/Library", "/System"),
    *(sys.prefix, sys.base_prefix),
)
_Status = tuple[int, int, int] | None  # changes with the content of a file; None if there is none

_opened: dict[str, _Status] = {}  # in the present run, with the status at the first time
_own_files: set[str] = set()
_unnamed: dict[Path, _Status] = {}  # opened in any run that did not name them: their content may have been kept since


def watch_files() -> None:
    """Begin a run: from now on remember the files that this process opens by Python's own functions."""
    _watch_once()
    _opened.clear()


def opened_files(named: Set[Path]) -> dict[str, str]:
    """Digests of the user's files that runs of this process have opened without naming them.

    The user's are all but those of libraries, of the system, and hidden ones. In the working directory and folders of
    named files, wherever these are, all but hidden ones count. Files that the process writes itself do not count.

    Args:
        named: files that the present run names.

    Raises:
        ValueError: one line, if one of them has changed since it was opened.
    """
    folders = {Path.cwd().resolve(), *(file.parent for file in named)}
    written = {os.path.realpath(path) for path in _own_files}
    for path, status in tuple(_opened.items()):
        file = Path(os.path.realpath(path))
        if str(file) not in written and file not in named and _is_users(file, folders):
            _unnamed.setdefault(file, status)
    present = [file for file in sorted(_unnamed) if file.is_file()]  # others were temporary
    for file in present:
        if _status(str(file)) != _unnamed[file]:
            raise ValueError(f"{file} has changed while the study ran: repeat the command")
    return {str(file): digest(file) for file in present}


@cache
def _watch_once() -> None:
    sys.addaudithook(_remember)  # cannot be removed


def _remember(event: str, arguments: tuple[Any, ...]) -> None:
    """Note an opened file; called before it is opened, and for every event of the process: must not raise."""
    if event != "open" or not isinstance(arguments[0], str | bytes | os.PathLike):
        return
    path = os.path.abspath(os.fsdecode(arguments[0]))
    if arguments[2] & os.O_ACCMODE != os.O_RDONLY:
        _own_files.add(path)
        return
    folder, name = os.path.split(path)
    if name.endswith(".pyc") and os.path.basename(folder) == "__pycache__":  # its source counts
        path = os.path.join(os.path.dirname(folder), f"{name.partition('.')[0]}.py")
    if path not in _opened:
        _opened[path] = _status(path)


def _status(path: str) -> _Status:
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _is_users(file: Path, folders: Set[Path]) -> bool:
    inside = [file.relative_to(folder) for folder in folders if file.is_relative_to(folder)]
    if is_library(file) or (not inside and any(file.is_relative_to(folder) for folder in _SYSTEM)):
        return False
    visible = any(not any(part.startswith(".") for part in path.parts) for path in inside or [file])
    return visible and file.is_file()  # a missing one may be the name of a file in another folder


_DERIVED: Final = (".pyc", ".md")  # files of offtrack that no number depends on


def content(scenario: Mapping[str, Any], *, portable: bool = False) -> str:
    """Hash of a resolved scenario, of all files and modules that it names, and of the software.

    A ``portable`` one leaves the machine out: processor and compiler.
    """
    on = installed() if portable else software()
    return hashlib.sha256(json.dumps([_content(scenario), on], sort_keys=True).encode()).hexdigest()


def identity(content: str, seed: int) -> str:
    """Identity of a run of a scenario of this ``content``."""
    return hashlib.sha256(f"{content} {seed}".encode()).hexdigest()[:20]


def _content(node: Any) -> Any:
    """The scenario with the content of files and modules in the place of their names."""
    if isinstance(node, Mapping):
        return {key: _content(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_content(value) for value in node]
    files = _files_of(node) if isinstance(node, str) else {}
    name = str(node).rpartition(":")[2] if isinstance(node, str) and is_import_path(node) else ""
    return [name, {key: digest(file) for key, file in files.items()}] if files else node


def named_files(node: Any) -> set[Path]:
    """All files that values of a scenario name, and those of its own modules."""
    return {file for text in texts(node) for file in _files_of(text).values()}


def _files_of(text: str) -> dict[str, Path]:
    """Files that a value stands for: own modules by their names, or a file of data as "data"."""
    if is_import_path(text):
        return named_modules(text)
    tyres = {name: Path(path).resolve() for name, path in tyre_files(text).items() if is_file(path)}
    return {"data": Path(text).resolve(), **tyres} if is_file(text) else {}


def software() -> tuple[str, ...]:
    """Everything that computes: offtrack's files, versions of libraries, the engine with the machine's features."""
    return (*installed(), str(compiler()))


@cache
def installed() -> tuple[str, str]:
    """Hash of offtrack's files, and versions of Python and the libraries as JSON."""
    sha = hashlib.sha256()
    for folder in package_folders():
        for file in sorted(folder.rglob("*")):
            if file.suffix not in _DERIVED and file.is_file():
                sha.update(f"{folder.name}/{file.relative_to(folder).as_posix()} {digest(file)}\n".encode())
    lines = [line for line in importlib.metadata.requires("offtrack") or () if ";" not in line]  # without extras
    needed = {name for line in lines for name in re.findall(r"^[\w.-]+", line)}
    libraries = {name: importlib.metadata.version(name) for name in sorted(needed)}
    return sha.hexdigest(), json.dumps([sys.version, libraries])


TABLES: Final = {"trailer_steering": "steering", "slip_compensation": "driving"}
_SUFFIX: Final = ".toml"


def parameters_beside(value: str) -> tuple[str, Path | None]:
    """Name of a part, and the file of its parameters: of ``law@tuned.toml`` they are ``law`` and ``tuned.toml``."""
    name, at, file = value.rpartition("@")
    return (name, Path(file)) if at and file.endswith(_SUFFIX) else (value, None)


def expanded(key: str, value: str) -> tuple[tuple[str, str], ...]:
    """Settings that a value of a key stands for: itself, or the part and its parameters.

    The file is a scenario, whose table of parameters counts, or that table alone.

    Raises:
        ValueError: one line, if the file can not be read or holds no such table.
    """
    name, file = parameters_beside(value)
    if file is None or key not in TABLES:
        return ((key, value),)
    prefix = TABLES[key]
    table: dict[str, Any] = read_toml(file, FileKind.SCENARIO)
    if prefix in table or "course" in table:
        table = table.get(prefix, {})
    plain = {name: text for name, text in table.items() if isinstance(text, bool | int | float | str)}
    if not plain or len(plain) != len(table):
        raise ValueError(f"{key} = {shown(value)}: the file must hold the table [{prefix}], or parameters alone")
    return ((key, name), *((f"{prefix}.{word}", _text(number)) for word, number in plain.items()))


def _text(value: bool | int | float | str) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


_CPU_FILE: Final = Path("/proc/cpuinfo")


class Provenance(NamedTuple):
    """Where and when a run was made."""

    host: str
    cpu: str
    python: str
    offtrack: str
    engine: str
    seconds: float  # of wall time
    ended: str  # UTC, ISO 8601

    @classmethod
    def of(cls, table: Any) -> "Provenance | None":
        """As it was saved; None for a run of before it was saved, or a damaged table."""
        try:
            return cls(**table)
        except TypeError:
            return None

    @property
    def machine(self) -> str:
        """Host and processor."""
        return f"{self.host} ({self.cpu})"


def provenance(since: float) -> dict[str, Any]:
    """Provenance of a run that began at ``since``, on the clock `time.monotonic`."""
    return Provenance(
        host=platform.node(),
        cpu=_cpu(),
        python=platform.python_version(),
        offtrack=importlib.metadata.version("offtrack"),
        engine=engine_name(),
        seconds=round(time.monotonic() - since, 3),
        ended=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    )._asdict()


@cache
def _cpu() -> str:
    """Name of the processor."""
    try:
        lines = _CPU_FILE.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, "") or platform.processor() or platform.machine()


def machines(runs: Iterable[Provenance | None]) -> tuple[str, ...]:
    """Machines that made these runs, without repetition."""
    return tuple(dict.fromkeys(one.machine for one in runs if one is not None))


MOST_CASES: Final = 20_000  # of a study
RUN: Final = "run"  # axis of finished runs
Settings = tuple[tuple[str, str], ...]  # key and value of every --set, in order


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One run: a scenario with settings and a seed."""

    scenario: str  # a name or a file
    fixed: Settings  # common to all runs of the study
    axes: Settings  # values of this run on the axes
    seed: int
    drawn: Settings = ()  # values that were drawn for this run; a key in braces is a word of other values

    @property
    def settings(self) -> tuple[str, ...]:
        """All settings as KEY=VALUE; of a part with a file of parameters, the parameters too."""
        pairs = (*self.fixed, *self.axes, *(pair for pair in self.drawn if not is_word(pair[0])))
        whole = ((key, composed(key, value, self.drawn)) for key, value in pairs)
        return tuple(f"{key}={value}" for pair in whole for key, value in expanded(*pair))

    @property
    def title(self) -> str:
        """Values on the axes and the seed, which identify the run in its study."""
        words = [(key, _short(value)) for key, value in self.drawn]
        drawn = (f"{key}={value}" for key, value in words if not is_word(key))
        axes = (f"{key}={composed(key, value, words)}" for key, value in self.axes)
        return " ".join([*axes, *drawn, f"seed={self.seed}"])

    def resolved(self) -> Scenario | RoverScenario:
        """The scenario with all settings.

        Raises:
            ValueError: one line, if it is not valid with these settings.
        """
        return load_any_scenario(self.scenario, self.settings)

    def identity(self) -> str:
        """Hash of all that the run depends on; equal for the same run in any study.

        Raises:
            ValueError: one line, if the scenario is not valid with these settings.
        """
        return identities([self])[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedCase(Case):
    """A finished run among others; its axis is its name."""

    @property
    def settings(self) -> tuple[str, ...]:
        """None: its scenario file holds all of them."""
        return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A run of a study with its summary."""

    case: Case
    numbers: Mapping[str, Any]  # its summary; {"outcome": "failed: …"} if it has none
    signals: Path | None = None  # file of its signals
    provenance: Provenance | None = None  # where and when; None: not known

    def number(self, path: str) -> float | None:
        """The number ``group.name`` of the summary; None if there is none."""
        return number_at(self.numbers, path)

    @property
    def completed(self) -> bool:
        """True if the run was completed."""
        return bool(self.numbers["outcome"] == "completed")


def identities(cases: Sequence[Case], *, portable: bool = False) -> list[str]:
    """Identity of every case; a scenario with its settings is resolved once for all seeds.

    A ``portable`` one is the same on machines with other processors and compilers.

    Raises:
        ValueError: one line, for the first scenario that is not valid with its settings.
    """
    contents: dict[tuple[str, tuple[str, ...]], str] = {}
    for case in cases:
        key = case.scenario, case.settings
        if key not in contents:
            contents[key] = content(case.resolved().model_dump(exclude_none=True), portable=portable)
    return [identity(contents[case.scenario, case.settings], case.seed) for case in cases]


def cases_of(
    scenario: str,
    fixed: Settings,
    axes: Mapping[str, Sequence[str]],
    seeds: Sequence[int],
    draws: Sequence[Settings] = ((),),
) -> Iterator[Case]:
    """Every combination of the axes' values, each with every seed; or each with all draws, which take turns with seeds.

    Raises:
        ValueError: one line, if there are too many.
    """
    sampled: list[tuple[int, Settings]] = [(seed, ()) for seed in seeds]
    if draws and draws[0]:
        sampled = [(seeds[k % len(seeds)], drawn) for k, drawn in enumerate(draws)]
    count = math.prod(map(len, axes.values())) * len(sampled)
    if count > MOST_CASES:
        raise ValueError(f"{count} runs: a study has at most {MOST_CASES}; use fewer values or seeds")
    for values in itertools.product(*axes.values()):
        point = tuple(zip(axes, values, strict=True))
        for seed, drawn in sampled:
            yield Case(scenario=scenario, fixed=fixed, axes=point, seed=seed, drawn=drawn)


def is_word(key: str) -> bool:
    """True for a drawn key in braces, ``{share}``: no key of the scenario, but a word in values of other keys."""
    return key.startswith("{") and key.endswith("}")


def composed(key: str, value: str, drawn: Iterable[tuple[str, str]]) -> str:
    """The value with drawn words in their places: ``{share}``, or ``{share:.3f}`` with three decimals.

    Raises:
        ValueError: one line, if a number cannot be written in the format.
    """
    for word, text in drawn:
        if is_word(word) and word[:-1] in value:
            value = re.sub(rf"{re.escape(word[:-1])}(:[^{{}}]*)?}}", partial(_written, key, text), value)
    return value


def _written(key: str, text: str, place: re.Match[str]) -> str:
    try:
        return format(float(text), place[1][1:]) if place[1] else text
    except ValueError:
        raise ValueError(f"{key}: {text} cannot be written as {shown(place[0])}: give a format such as :.3f") from None


def _short(value: str) -> str:
    """A number with four digits, other values as they are."""
    try:
        return f"{float(value):.4g}"
    except ValueError:
        return value


def listed(text: str, name: str) -> tuple[str, ...]:
    """Split a comma-separated list; commas within brackets belong to a value.

    Raises:
        ValueError: one line, if it is empty or names a value twice.
    """
    values, depth = [""], 0
    for letter in text:
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and depth == 0:
            values.append("")
        else:
            values[-1] += letter
    stripped = tuple(value.strip() for value in values)
    if not all(stripped) or len(set(stripped)) != len(stripped):
        raise ValueError(f"{name} {text}: expected different values, separated by commas")
    return stripped


def seeds_of(text: str) -> tuple[int, ...]:
    """Parse seeds written as 3, 1,2,5 or 1-5.

    Raises:
        ValueError: one line, if it is none of these.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or int(last or first) < int(first):
            raise ValueError(f"--seeds {text}: expected whole numbers such as 3, 1,2,5 or 1-5")
        count = len(seeds) + int(last or first) - int(first) + 1
        if count > MOST_CASES:
            raise ValueError(f"--seeds {text}: {count} seeds; a study has at most {MOST_CASES} runs")
        seeds.extend(range(int(first), int(last or first) + 1))
    if len(set(seeds)) != len(seeds):
        raise ValueError(f"--seeds {text}: a seed is named twice")
    return tuple(seeds)
