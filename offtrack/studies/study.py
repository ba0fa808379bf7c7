"""A study: a grid of runs and its TOML file, and the scenario keys that studies vary."""

import hashlib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import tomli_w
from pydantic import Field, field_validator

from offtrack.studies.case import (
    Case,
    Outcome,
    Settings,
    cases_of,
    expanded,
    identities,
    is_word,
    listed,
    parameters_beside,
)
from offtrack.studies.draws import Draws, Sample, Sensitivity, Stop, number_of, read_draws
from offtrack.studies.table import QUANTITIES, exceeding
from scenarios.assembly.drivers_and_laws import law_uses_off_tracking
from scenarios.catalogue import OFF_TRACKING, ROVER_DRIVER, SLIP_ESTIMATOR, TRAILER_STEERING, Catalogue
from scenarios.options.scenario import load_any_scenario
from vehicle.foundation.quantity import Frozen, checked
from vehicle.foundation.user_file import FileType, dotted, nearest, parsed_toml, read_toml, shown

STUDY_FILE: Final = FileType("a study file", 2_000_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Scenario keys of a kind of vehicle, with the defaults of ``compare`` and ``tune``."""

    compared: str  # key that ``compare --controllers`` varies
    controllers: tuple[str, ...]  # its values, if none are given
    estimator: str  # key of the estimator
    estimators: Catalogue
    tuned: str  # key of the part that ``tune`` tunes
    parts: Catalogue
    part: str  # tuned if none is given
    parameters: str  # table of its parameters
    objectives: tuple[str, ...]


TRAILER: Final = Subject(
    compared="trailer_steering",
    controllers=("none", "command_steer", "path_preview"),
    estimator="off_tracking",
    estimators=OFF_TRACKING,
    tuned="trailer_steering",
    parts=TRAILER_STEERING,
    part="path_preview",
    parameters="steering",
    objectives=("off_tracking.true_rms_m", "off_tracking.true_max_m"),
)
ROVER: Final = Subject(
    compared="slip_compensation",
    controllers=("none", "heading", "crab"),
    estimator="slip_estimator",
    estimators=SLIP_ESTIMATOR,
    tuned="driver",
    parts=ROVER_DRIVER,
    part="path",
    parameters="driving",
    objectives=("slip.cross_track_rms_m",),
)
SUBJECTS: Final = {"trailer": TRAILER, "rover": ROVER}  # by the ``vehicle_kind`` of a scenario


def subject_of(scenario: str) -> Subject:
    """The subject of a scenario's studies.

    Raises:
        ValueError: one line, if there is no such scenario.
    """
    return SUBJECTS[load_any_scenario(scenario).vehicle_kind]


FILE = "study.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A grid of runs."""

    file: ClassVar[str] = FILE  # its name in the directory of the study

    scenario: str
    fixed: Settings
    axes: Mapping[str, Sequence[str]]  # every key with its values as text
    seeds: tuple[int, ...]
    draws: Draws = field(default_factory=Draws)
    limits: Mapping[str, float] = field(default_factory=dict)  # of numbers of the summary, by their paths
    stop: Stop | None = None  # None: all draws are made

    def __post_init__(self) -> None:
        """Refuse a key that two places of the study give different values.

        Raises:
            ValueError: one line.
        """
        varied = [(f"{key} = {shown(', '.join(v))} is varied", key, v) for key, v in self.axes.items()]
        drawn = [(f"{key} is drawn", key, ("",)) for key in self.draws.distributions if not is_word(key)]
        known = [(f"{key} = {shown(value)} is set", key, value) for key, value in dict(self.fixed).items()]
        for place, key, values in (*varied, *drawn):
            pairs = [pair for value in values for pair in expanded(key, value)]
            for earlier, first, value in known:
                if any((first == name and value != text) or first.startswith(f"{name}.") for name, text in pairs):
                    raise ValueError(f"{earlier}, and {place}: choose one")
            known += [(place, *pair) for pair in pairs]

    def cases(self) -> list[Case]:
        """All runs; a law that does not use the off-tracking runs with the first off-tracking source only."""
        sources = self.axes.get("off_tracking", ())
        cases = cases_of(self.scenario, self.fixed, self.axes, self.seeds, list(self.draws.settings()))
        chosen = [
            case
            for case in cases
            if dict(case.axes).get("off_tracking") in (None, *sources[:1]) or _uses_off_tracking(case)
        ]
        has_words = self.draws.sample is not None and any(map(is_word, self.draws.distributions))
        return _without_repetition(chosen) if has_words else chosen

    def intervals(self, outcomes: Sequence[Outcome], axes: Settings) -> Iterator[tuple[float, float]]:
        """Intervals of the probabilities that ``stop`` looks at, of the point with these axes."""
        return (exceeding(outcomes, axes, path, limit).interval() for path, limit in self.limits.items())

    @classmethod
    def load(cls, path: Path) -> "Study":
        """Load a study of this kind from TOML; see `load_study`."""
        return load_study(path)

    def identity(self) -> str:
        """Hash of the identities of all runs.

        Raises:
            ValueError: one line, for the first invalid scenario.
        """
        return hashlib.sha256(" ".join(identities(self.cases())).encode()).hexdigest()[:20]

    def to_toml(self) -> str:
        """The study as TOML for `offtrack sweep`."""
        vary = {key: [typed_value(value) for value in values] for key, values in self.axes.items()}
        fixed = {key: typed_value(value) for key, value in self.fixed}
        more = self.draws.tables() | ({"limits": dict(self.limits)} if self.limits else {})
        more |= {"stop": self.stop.model_dump()} if self.stop else {}
        return tomli_w.dumps({"scenario": self.scenario, "seeds": list(self.seeds), "set": fixed, "vary": vary, **more})


class StudyFile(Frozen):
    """Tables that files of studies and of campaigns share."""

    scenario: str
    seeds: tuple[Annotated[int, Field(ge=0, strict=True)], ...] = Field((1,), min_length=1)
    set: dict[str, Any] = Field(default_factory=dict)
    vary: dict[str, Any] = Field(default_factory=dict)
    sample: Sample | None = None
    draw: dict[str, Any] = Field(default_factory=dict)
    stop: Stop | None = None

    @field_validator("seeds")
    @classmethod
    def _different(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is named twice")
        return seeds

    @property
    def fixed(self) -> Settings:
        """The table ``set``."""
        return tuple((key, text_of_value(value)) for key, value in dotted(self.set))

    def axes(self, place: str, taken: str = "") -> dict[str, tuple[str, ...]]:
        """The table ``vary``; ``taken`` is an axis that it must not have.

        Raises:
            ValueError: one line, naming the key.
        """
        axes: dict[str, tuple[str, ...]] = {}
        for key, values in dotted(self.vary):
            texts = tuple(map(text_of_value, values)) if isinstance(values, list | tuple) else ()
            if not texts or len({*texts}) < len(texts) or key in (*axes, taken):
                hint = f"; {taken} are in tables of their own" if taken else ""
                raise ValueError(f"{place}: vary.{shown(key)} must be one list of different values{hint}")
            axes[key] = texts
        return axes


class _File(StudyFile):
    limits: dict[str, Any] = Field(default_factory=dict)
    sensitivity: Sensitivity | None = None


def load_study(path: Path) -> Study:
    """Load a study from TOML.

    It has scenario, seeds, and the tables ``set``, ``vary``, ``sample``, ``draw``, ``limits``, ``stop`` and
    ``sensitivity``. Keys are dotted, in quotes or not: ``"surface.friction" = 0.3``, ``surface.friction = 0.3`` and a
    table ``[set.surface]`` mean the same.

    Raises:
        ValueError: one line, naming file and key.
    """
    table = checked(_File, read_toml(path, STUDY_FILE), f"study {path}")
    axes = table.axes(f"study {path}")
    draws = read_draws(str(path), table.sample, list(dotted(table.draw)), table.sensitivity)
    if twice := sorted(set(draws.distributions) & set(axes)):
        raise ValueError(f"study {path}: {twice[0]} is varied and drawn: choose one")
    if not axes and not draws:
        raise ValueError(f"study {path}: has neither a table [vary] nor [sample] and [draw]")
    if table.sensitivity and (table.limits or table.stop or len(table.seeds) > 1):
        raise ValueError(
            f"study {path}: [sensitivity] goes with one seed, and without [limits] and [stop]: its draws are a design"
        )
    if table.stop and not (draws and table.limits):
        raise ValueError(
            f"study {path}: [stop] is for drawn values with limits: a table [sample] or [limits] is missing"
        )
    return Study(
        scenario=table.scenario,
        fixed=table.fixed,
        axes=axes,
        seeds=table.seeds,
        draws=draws,
        limits={key: _limit(path, key, value) for key, value in dotted(table.limits)},
        stop=table.stop,
    )


def _limit(path: Path, key: str, value: Any) -> float:
    known = [quantity.path for quantity in QUANTITIES]
    if key not in known:
        raise ValueError(f"study {path}: limits.{shown(key)}{nearest(key, known)}")
    return number_of(f"study {path}: limits.{key}", value)


def settings_of(pairs: Sequence[str], option: str) -> Settings:
    """Split every KEY=VALUE into key and value.

    Raises:
        ValueError: one line, for a malformed pair.
    """
    settings = []
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise ValueError(f"{option} {pair}: expected KEY=VALUE")
        settings.append((key.strip(), value.strip()))
    return tuple(settings)


def axes_of(pairs: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Values by key of every ``--vary KEY=VALUE,VALUE``.

    Raises:
        ValueError: one line, for a malformed pair, or a key that is named twice.
    """
    axes: dict[str, tuple[str, ...]] = {}
    for key, text in settings_of(pairs, "--vary"):
        if key in axes:
            raise ValueError(f"--vary {key}: is named twice: give all its values at once")
        axes[key] = listed(text, f"--vary {key}")
    return axes


def _uses_off_tracking(case: Case) -> bool:
    """False if the law of a run is on an axis and does not use the off-tracking."""
    law = dict(case.axes).get("trailer_steering")
    return law is None or law_uses_off_tracking(parameters_beside(law)[0])


def _without_repetition(cases: Sequence[Case]) -> list[Case]:
    """The cases without those that a case before them equals, as no drawn word is in their values."""
    first: dict[tuple[Settings, tuple[str, ...], int], Case] = {}
    for case in cases:
        first.setdefault((case.axes, case.settings, case.seed), case)
    return list(first.values())


def typed_value(text: str) -> Any:
    """The TOML value of a setting's text, or else the text itself."""
    try:
        return parsed_toml(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def text_of_value(value: Any) -> str:
    """A value of a TOML file as ``--set`` takes it."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | dict):
        return tomli_w.dumps({"value": value}).partition("=")[2].strip()
    return repr(value)
