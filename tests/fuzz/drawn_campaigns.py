"""Random fault campaigns by file or scenario: any fault, lists and distributions, requirements, bisections."""

from collections.abc import Sequence
from typing import Any, Final

import tomli_w
from hypothesis import strategies as st

from offtrack.reports.sections import groups
from offtrack.studies.campaigns.verdict import GROUPS, OUTCOMES
from scenarios import catalogue
from tests.fuzz.case import Case
from tests.fuzz.drawn_scenarios import ROVERS, TRAILERS, drawn_settings
from tests.fuzz.files import settings
from tests.fuzz.specimens import SHORT, SHORT_ROVER

_KINDS: Final = sorted(catalogue.FAULT)
_NUMBERS: Final = [f"{group}.{name}" for group in GROUPS for name in groups()[group].numbers]
_AMOUNT: Final = st.sampled_from([0.1, 0.5, 1, 3.0, 20])
_TIME: Final = st.sampled_from([0, 0.2, 0.5, 1.0, 3])
_ODD: Final[Sequence[Any]] = (
    *(-1, 1e9, 1e308, float("nan"), float("inf"), True, "", "x", "end", "none", "[/b]", "a" * 300, "\u202e", "{x}"),
    *([], [1], [[1, 2]], [1, 1], {}, {"a": 1}, {"uniform": [1, 2]}, {"uniform": [2, 1]}, {"normal": ["x", 1]}),
    *(10**30, 2**63, list(range(501)), {"uniform": [0, float("inf")]}, {"choice": []}, {"choice": [0.5, 1.0]}),
)


def _spread(value: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    listed = st.lists(value, min_size=1, max_size=2, unique=True)
    return listed | listed | st.sampled_from([{"uniform": [0.1, 0.9]}, {"choice": [0.2, 0.4]}])


_FAULT: Final = st.fixed_dictionaries(
    {"kind": st.sampled_from(_KINDS)},
    optional={
        "amounts": _spread(_AMOUNT),
        "onsets": _spread(_TIME),
        "durations": st.sampled_from([[0.5], ["end"], [0.2, "end"]]),
        "name": st.sampled_from(["one", "two"]),
        "seeds": st.just([1]),
        "only": st.sampled_from([{"trailer_steering": "none"}, {"slip_compensation": "none"}, {"x": 1}]),
    },
)
_LIMIT: Final = st.sampled_from([0.05, 0.5, 30, {"min": 0}, {"min": -1, "max": 2}])
_TIMES: Final = {
    "time_to_detect_s": st.sampled_from([0.2, 1]),
    "time_to_recover_s": st.sampled_from([0.5, 5]),
    "harmless_below_m": st.just(0.1),
    "recovered_below_m": st.just(0.2),
    "outcomes": st.lists(st.sampled_from(OUTCOMES), min_size=1, max_size=3, unique=True),
}


@st.composite
def campaigns(draw: st.DrawFn) -> Case:
    """A campaign; its runs end after some steps, as if the vehicle were stuck, so that there is something to judge."""
    is_rover = draw(st.integers(0, 3)) == 3
    short = list(SHORT_ROVER if is_rover else SHORT)
    pairs = draw(drawn_settings(is_rover=is_rover, cameras=False)) if draw(st.integers(0, 4)) == 4 else short
    tail, kind, steps = ("--quiet", "--out", "out", "--jobs", "1"), "scenario: campaign", draw(st.sampled_from([3, 40]))
    if draw(st.integers(0, 5)) == 5:
        scenario = draw(st.sampled_from(ROVERS if is_rover else TRAILERS))
        options = draw(_options(is_rover=is_rover))
        command = ("campaign", scenario, *settings(*pairs), *options, *tail)
        return Case(kind=kind, command=command, steps=steps, ends=True)
    table = draw(_tables(is_rover=is_rover))
    table["set"] = dict(pair.split("=", 1) for pair in pairs)
    if draw(st.integers(0, 2)) == 2:
        _spoil(draw, table)
    files = (("campaign.toml", tomli_w.dumps(table).encode("utf-8", "replace")),)
    return Case(kind=kind, command=("campaign", "campaign.toml", *tail), files=files, steps=steps, ends=True)


@st.composite
def _options(draw: st.DrawFn, *, is_rover: bool) -> tuple[str, ...]:
    laws = draw(st.sampled_from(["none", "none,crab", "x", ""] if is_rover else ["none", "command_steer", "x", ""]))
    seeds = draw(st.sampled_from(["1", "1,2", "2-1", "x", ""]))
    return ("--controllers", laws, "--seeds", seeds)


@st.composite
def _tables(draw: st.DrawFn, *, is_rover: bool) -> dict[str, Any]:
    law, laws = ("slip_compensation", ["none", "crab"]) if is_rover else ("trailer_steering", ["none", "command_steer"])
    faults = draw(st.lists(_FAULT, min_size=1, max_size=2))
    table: dict[str, Any] = {
        "scenario": "rover-slope" if is_rover else "lane-change",
        "seeds": draw(st.sampled_from([[1], [1, 2]])),
        "vary": {law: draw(st.lists(st.sampled_from(laws), min_size=1, max_size=2, unique=True))},
        "fault": faults,
        "requirements": draw(st.fixed_dictionaries({draw(st.sampled_from(_NUMBERS)): _LIMIT}, optional=_TIMES)),
    }
    if draw(st.booleans()):
        table["reference"] = draw(st.booleans())
    if draw(st.integers(0, 2)) == 2:
        title = faults[0].get("name", faults[0]["kind"])
        search = {"fault": title, "of": "amount", "low": 0.1, "high": 1.0, "tolerance": 0.4}
        table["bisect"] = [search | draw(st.sampled_from([{}, {"of": "duration"}, {"onset": 0.1}, {"low": 2.0}]))]
    if "uniform" in str(faults) or "choice" in str(faults) or draw(st.integers(0, 5)) == 5:
        table["sample"] = draw(st.sampled_from([{"count": 2}, {"count": 4, "method": "sobol"}, {"count": 0}]))
        table |= draw(
            st.sampled_from(
                [
                    {},
                    {"stop": {"half_width": 0.4, "batch": 2}},
                    {"draw": {"speed_kmh": {"uniform": [5, 20]}}},
                    {"draw": {"speed_kmh": 3}},
                ]
            )
        )
    if draw(st.booleans()):
        table["accept"] = {"probability": draw(st.sampled_from([0.1, 0.999]))}
    return table


def _spoil(draw: st.DrawFn, table: dict[str, Any]) -> None:
    places = [(table, key) for key in table]
    places += [(inner, key) for one in table.values() for inner in _inner(one) for key in inner]
    where, key = draw(st.sampled_from(places))
    if draw(st.integers(0, 4)) == 4:
        where[f"{key}x"] = where.pop(key)
    else:
        where[key] = draw(st.sampled_from(_ODD))


def _inner(value: Any) -> list[dict[str, Any]]:
    if isinstance(value, dict):
        return [value, *(one for part in value.values() for one in _inner(part))]
    return [one for part in value for one in _inner(part)] if isinstance(value, list) else []
