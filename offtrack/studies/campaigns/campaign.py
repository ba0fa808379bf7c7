"""A campaign: a study whose first axis are faults, with requirements, and its TOML file."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import tomli_w
from pydantic import Field

from offtrack.studies.campaigns.fault_entry import NONE, Bisect, FaultEntry, Pairs
from offtrack.studies.campaigns.verdict import Judgement, Requirements, read_requirements, verdict_on
from offtrack.studies.case import Case, Outcome, Settings
from offtrack.studies.draws import read_draws
from offtrack.studies.study import STUDY_FILE, Study, StudyFile, text_of_value, typed_value
from offtrack.studies.table import Exceeding
from vehicle.foundation.quantity import Frozen, checked
from vehicle.foundation.user_file import dotted, nearest, read_toml, shown

FILE: Final = "campaign.toml"
FAULTS: Final = "faults"  # axis
LAWS: Final = ("trailer_steering", "slip_compensation", "driver")  # axes that tables and figures compare


class Accept(Frozen):
    """Probability at which the command fails: the table ``accept``."""

    probability: Annotated[float, Field(gt=0.0, lt=1.0)]  # largest upper limit of the interval, of each fault and law
    only: dict[str, Any] = Field(default_factory=dict)  # values of the axes that count; others: all


Choice = FaultEntry | Bisect | Accept  # of seeds and values of the axes


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign(Study):
    """A grid of runs with faults, and what they must keep."""

    file: ClassVar[str] = FILE

    entries: tuple[FaultEntry, ...]
    of_text: Mapping[str, FaultEntry]  # the entries by their values on the axis of faults
    reference: bool = True  # runs without a fault, too
    requirements: Requirements
    accept: Accept | None = None
    bisections: tuple[Bisect, ...] = ()
    description: str = ""

    def cases(self) -> list[Case]:
        """All runs that the entries want; of the reference those with which any entry is compared."""
        cases = [(self.entry_of(case), case) for case in Study.cases(self)]
        wanted = {(self.others(case), case.seed) for entry, case in cases if entry and wants(entry, case)}
        return [
            case for entry, case in cases if (wants(entry, case) if entry else (self.others(case), case.seed) in wanted)
        ]

    def entry_of(self, case: Case) -> FaultEntry | None:
        """The entry that a run belongs to; None: it is a reference."""
        return self.of_text.get(dict(case.axes)[FAULTS])

    @property
    def law(self) -> str:
        """The axis whose values tables and figures compare; empty: none."""
        return next((key for key in LAWS if key in self.axes), "")

    @property
    def further(self) -> tuple[str, ...]:
        """The axes with several values, without those of faults and laws."""
        return tuple(key for key, values in self.axes.items() if key not in (FAULTS, self.law) and len(values) > 1)

    def others(self, case: Case) -> Settings:
        """Values on all axes but the faults'."""
        return tuple(pair for pair in case.axes if pair[0] != FAULTS)

    def judge(self, outcome: Outcome) -> Judgement:
        """Verdict on a run."""
        entry = self.entry_of(outcome.case)
        return verdict_on(outcome, entry.title if entry else NONE, self.requirements)

    def intervals(self, outcomes: Sequence[Outcome], axes: Settings) -> Iterator[tuple[float, float]]:
        """Interval of the probability to fail at a point."""
        runs = [self.judge(outcome) for outcome in outcomes if outcome.case.axes == axes]
        yield Exceeding(sum(run.failed for run in runs), len(runs)).interval()

    @classmethod
    def load(cls, path: Path) -> "Campaign":
        """Load a campaign from TOML; see `load_campaign`."""
        return load_campaign(path)

    def to_toml(self) -> str:
        """The campaign as TOML for `offtrack campaign`."""
        vary = {key: list(map(typed_value, values)) for key, values in self.axes.items() if key != FAULTS}
        own = {key.rpartition(".")[0] for entry in self.entries for key, _ in entry.drawn()}
        drawn = self.draws.tables()
        draw = {key: value for key, value in drawn.get("draw", {}).items() if key not in own}
        tables = {
            "set": {key: typed_value(value) for key, value in self.fixed},
            "vary": vary,
            "requirements": self.requirements.table(),
            "sample": drawn.get("sample"),
            "draw": draw,
            "stop": self.stop and self.stop.model_dump(),
            "accept": self.accept and self.accept.model_dump(),
            "fault": [entry.model_dump(exclude_defaults=True) for entry in self.entries],
            "bisect": [one.model_dump(exclude_defaults=True) for one in self.bisections],
        }
        head: dict[str, Any] = {"description": self.description} if self.description else {}
        head |= {"scenario": self.scenario, "seeds": list(self.seeds), "reference": self.reference}
        return tomli_w.dumps(head | {key: table for key, table in tables.items() if table})


def wants(entry: Choice, case: Case) -> bool:
    """True if an entry is about a run, by its seeds and its values of the axes."""
    seeds = getattr(entry, "seeds", ()) or (case.seed,)
    axes = dict(case.axes)
    return case.seed in seeds and all(axes.get(key) in texts for key, texts in _only(entry).items())


def _only(entry: Choice) -> dict[str, list[str]]:
    listed = ((key, value if isinstance(value, list | tuple) else [value]) for key, value in dotted(entry.only))
    return {key: [text_of_value(value) for value in values] for key, values in listed}


class _File(StudyFile):
    description: str = ""
    reference: bool = True
    requirements: dict[str, Any]
    fault: tuple[FaultEntry, ...] = ()
    pairs: Pairs | None = None
    bisect: tuple[Bisect, ...] = ()
    accept: Accept | None = None


def campaign_names() -> tuple[str, ...]:
    """Names of the campaigns that come with offtrack."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _data().iterdir() if file.name.endswith(".toml")))


def _data() -> resources.abc.Traversable:
    return resources.files("scenarios") / "data" / "campaigns"


def campaign_path(name: str) -> Path | None:
    """File of a campaign that comes with offtrack, or of the user's own; None: the name is neither."""
    if name in campaign_names():
        return Path(str(_data() / f"{name}.toml"))
    path = Path(name)
    is_campaign = name.endswith(".toml") and path.is_file() and {"fault", "pairs"} & set(read_toml(path, STUDY_FILE))
    return path if is_campaign else None


def load_campaign(path: Path) -> Campaign:
    """Load a campaign from TOML.

    It has scenario, seeds, and the tables ``set``, ``vary``, ``requirements``, ``fault`` (a list), and if wanted
    ``bisect`` (a list), ``sample``, ``draw``, ``stop`` and ``accept``.

    Raises:
        ValueError: one line, naming file and key.
    """
    place = f"campaign {path}"
    table = checked(_File, read_toml(path, STUDY_FILE), place)
    entries = (*table.fault, *(table.pairs.entries() if table.pairs else ()))
    if not entries:
        raise ValueError(f"{place}: a table [[fault]] or [pairs] is missing")
    of_text = by_text(place, entries)
    axes = {FAULTS: (*((NONE,) if table.reference else ()), *of_text), **table.axes(place, taken=FAULTS)}
    drawn = [pair for entry in entries for pair in entry.drawn()]
    draws = read_draws(str(path), table.sample, [*drawn, *dotted(table.draw)])
    if table.stop and not draws:
        raise ValueError(f"{place}: [stop] is for drawn values: a table [sample] is missing")
    campaign = Campaign(
        scenario=table.scenario,
        fixed=table.fixed,
        axes=axes,
        seeds=table.seeds,
        draws=draws,
        stop=table.stop,
        entries=entries,
        of_text=of_text,
        reference=table.reference,
        requirements=read_requirements(place, dotted(table.requirements)),
        accept=table.accept,
        bisections=table.bisect,
        description=table.description,
    )
    chosen: list[Choice] = [*entries, *table.bisect, *([table.accept] if table.accept else [])]
    for one in chosen:
        _check_choice(place, one, campaign)
    _check_bisections(place, campaign)
    return campaign


def with_changes(campaign: Campaign, settings: Settings, seeds: tuple[int, ...] | None) -> Campaign:
    """The campaign with further settings in all runs, and with other seeds, for its faults too.

    An axis that is set has this value alone; entries that are about its other values alone make no runs.
    """
    given = dict(settings)
    fixed = (*(pair for pair in campaign.fixed if pair[0] not in given), *settings)
    axes = {key: (given[key],) if key in given else values for key, values in campaign.axes.items()}
    changed = dataclasses.replace(campaign, fixed=fixed, axes=axes)
    if seeds is None:
        return changed
    entries = tuple(entry.model_copy(update={"seeds": ()}) for entry in campaign.entries)
    bisections = tuple(one.model_copy(update={"seeds": ()}) for one in campaign.bisections)
    of_text = by_text("campaign", entries)
    return dataclasses.replace(changed, seeds=seeds, entries=entries, of_text=of_text, bisections=bisections)


def by_text(place: str, entries: Sequence[FaultEntry]) -> dict[str, FaultEntry]:
    """The entries by all their texts.

    Raises:
        ValueError: one line, for a value that a kind does not take, or two entries that can't be told apart.
    """
    by_text, titles = dict[str, FaultEntry](), set[str]()
    for entry in entries:
        try:
            entry.check()
            texts = entry.texts()
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from None
        if twice := entry.title if entry.title in titles else next((text for text in texts if text in by_text), ""):
            raise ValueError(f"{place}: fault {twice} is named twice: give the entries different names and values")
        by_text |= dict.fromkeys(texts, entry)
        titles.add(entry.title)
    return by_text


def _check_choice(place: str, entry: Choice, campaign: Campaign) -> None:
    """Refuse seeds and values that the campaign has not."""
    for seed in getattr(entry, "seeds", ()):
        if seed not in campaign.seeds:
            raise ValueError(f"{place}: seed {seed} is none of the campaign's seeds")
    for key, values in _only(entry).items():
        if key not in campaign.axes:
            raise ValueError(f"{place}: only.{shown(key)}{nearest(key, [k for k in campaign.axes if k != FAULTS])}")
        for value in values:
            if value not in campaign.axes[key]:
                raise ValueError(f"{place}: only.{key}: {shown(value)}{nearest(value, campaign.axes[key])}")


def _check_bisections(place: str, campaign: Campaign) -> None:
    entries = {entry.title: entry for entry in campaign.entries}
    for one in campaign.bisections:
        if one.fault not in entries:
            raise ValueError(f"{place}: bisect.fault = {shown(one.fault)}{nearest(one.fault, entries)}")
        for value in (one.low, one.high):
            try:
                one.text_of(entries[one.fault], value)
            except ValueError as error:
                raise ValueError(f"{place}: bisect {one.fault}: {error}") from None
