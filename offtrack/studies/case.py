"""One run of a study: a scenario with settings and a seed, its summary, and where it was made."""

from __future__ import annotations

import importlib.metadata
import itertools
import math
import platform
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from offtrack.studies.identity import content, identity
from scenarios.options.rover_scenario import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.results.summary_numbers import number_at
from vehicle.engine.compiler import engine_name
from vehicle.foundation.parameter_file import read_toml
from vehicle.foundation.user_file import FileKind, shown

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


class Made(NamedTuple):
    """Where and when a run was made."""

    host: str
    cpu: str
    python: str
    offtrack: str
    engine: str
    seconds: float  # of wall time
    ended: str  # UTC, ISO 8601

    @classmethod
    def of(cls, table: Any) -> Made | None:
        """As it was saved; None for a run of before it was saved, or a damaged table."""
        try:
            return cls(**table)
        except TypeError:
            return None

    @property
    def machine(self) -> str:
        """Host and processor."""
        return f"{self.host} ({self.cpu})"


def made(since: float) -> dict[str, Any]:
    """Provenance of a run that began at ``since``, on the clock `time.monotonic`."""
    return Made(
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


def machines(provenance: Iterable[Made | None]) -> tuple[str, ...]:
    """Machines that made these runs, without repetition."""
    return tuple(dict.fromkeys(one.machine for one in provenance if one is not None))


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
    made: Made | None = None  # where and when; None: not known

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
