"""Verdicts, response times, probabilities and bisection of campaigns, on made-up runs."""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from offtrack.studies.campaigns import failures
from offtrack.studies.campaigns.campaign import Campaign, load_campaign
from offtrack.studies.campaigns.campaign_page import campaign_page, searches_table
from offtrack.studies.campaigns.fault_entry import FaultTime
from offtrack.studies.campaigns.verdict import END_OF_RUN, Limit, response, verdict_on
from offtrack.studies.case import Case, Outcome
from scenarios.results.log import Log, Signal, write_log
from vehicle.frames import FloatArray

FILE = """scenario = "roundabout"
[vary]
trailer_steering = ["path_preview", "mpc"]
[requirements]
off_tracking.true_max_m = 0.5
road.wheel_clearance_left_m.min = 0
time_to_detect_s = 1
time_to_recover_s = 3
[accept]
probability = 0.9
[[fault]]
kind = "gyro_bias"
amounts = [1, 5]
onsets = [4]
durations = [2]
[[fault]]
kind = "wheel_speed_dropout"
onsets = [4]
[[bisect]]
fault = "gyro_bias"
low = 0
high = 10
tolerance = 0.25
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    path = tmp_path / "campaign.toml"
    path.write_text(FILE, encoding="utf-8")
    return load_campaign(path)


def log(off_tracking: FloatArray, health: FloatArray, fallback: FloatArray | None = None) -> Log:
    columns: dict[str, FloatArray] = {"time": TIME, "off_tracking_true_trailer": off_tracking, "health_trailer": health}
    columns |= {} if fallback is None else {"fallback_trailer": fallback}
    return Log.of((Signal(name, "-", ""), values) for name, values in columns.items())


TIME: FloatArray = np.arange(1001, dtype=np.float64) * 0.01
WELL = np.zeros(1001)
CAPTURES = np.where(np.arange(1001) % 10 == 0, 0.0, np.nan)  # health ok, ten times a second


WITHIN: dict[str, Any] = {"recovered_below": 0.2, "completed": True}  # [m]


def between(low: float, high: float, value: float = 1.0) -> FloatArray:
    return np.where((low - 1e-9 <= TIME) & (high - 1e-9 > TIME), value, 0.0)


def test_a_fault_is_detected_by_the_estimate_or_by_the_guard_whichever_is_first() -> None:
    """Health is known at captures only, and holds until the next one."""
    fault = FaultTime(4.0, 6.0)
    by_health = log(WELL, CAPTURES + between(4.65, 6.0))
    both = log(WELL, CAPTURES + between(4.65, 6.0), between(4.4, 7.0))
    assert response(by_health, fault, **WITHIN).detection == pytest.approx(0.7)
    assert response(both, fault, **WITHIN).detection == pytest.approx(0.4)
    assert response(log(WELL, CAPTURES), fault, **WITHIN).detection == math.inf
    early = log(WELL, CAPTURES + between(3.0, 5.0))
    assert response(early, fault, **WITHIN).detection == pytest.approx(0.0)
    columns = {"time": TIME, "health": CAPTURES + between(4.65, 6.0), "cross_track_true": between(5.0, 8.0, -0.3)}
    rover = response(Log.of((Signal(name, "-", ""), values) for name, values in columns.items()), fault, **WITHIN)
    assert (rover.detection, rover.recovery, rover.deviation) == pytest.approx((0.7, 2.0, 0.3))


def test_recovery_needs_a_second_in_which_all_is_well() -> None:
    """The follow point comes back at 7.0 s, leaves once more from 7.5 to 8.0 s, and stays from then on."""
    fault, away = FaultTime(4.0, 6.0), between(5.0, 7.0, 0.5) + between(7.5, 8.0, -0.5)
    measured = response(log(away, CAPTURES), fault, **WITHIN)
    assert measured.recovery == pytest.approx(2.0)
    assert response(log(away, CAPTURES), fault, recovered_below=0.6, completed=True).recovery == pytest.approx(0.0)
    late = log(between(5.0, 9.5, 0.5), CAPTURES)
    assert response(late, fault, **WITHIN).recovery == pytest.approx(3.5)
    assert response(late, fault, recovered_below=0.2, completed=False).recovery == math.inf
    fallback = log(WELL, CAPTURES, between(4.5, 9.0))
    assert response(fallback, fault, **WITHIN).recovery == pytest.approx(3.0)


def test_times_that_do_not_apply_are_not_numbers() -> None:
    """No fault, a fault that never ends, and one that never began; an alarm without a fault is a false one."""
    start = np.where(TIME < 1.0, 2.0, 0.0) + CAPTURES  # lost until the path is long enough
    quiet = response(log(WELL, start), None, **WITHIN)
    assert math.isnan(quiet.detection)
    assert not quiet.alarm
    assert response(log(WELL, CAPTURES + between(6.0, 6.5)), None, **WITHIN).alarm
    lasting = response(log(WELL, CAPTURES + between(4.0, 9.0)), FaultTime(4.0, None), **WITHIN)
    assert lasting.detection == pytest.approx(0.0)
    assert math.isnan(lasting.recovery)
    beyond = response(log(WELL, CAPTURES), FaultTime(12.0, 13.0), **WITHIN)
    assert math.isnan(beyond.detection)
    assert math.isnan(beyond.recovery)
    empty = Log.of((Signal(name, "-", ""), []) for name in ("time", "off_tracking_true_trailer"))
    assert math.isnan(response(empty, FaultTime(0.0, 1.0), recovered_below=0.2, completed=False).detection)


def test_the_severity_of_a_limit_is_one_at_the_limit() -> None:
    upper, lower, both = Limit("steer.max_deg", high=40.0), Limit("x.y", low=0.0), Limit("x.y", low=2.0, high=4.0)
    assert (upper.severity(40.0), upper.severity(60.0)) == (1.0, 1.5)
    assert (lower.severity(0.0), lower.severity(0.5), lower.severity(-0.5)) == (1.0, 0.5, 1.5)
    assert (both.severity(2.0), both.severity(4.0)) == (1.0, 1.0)
    assert both.severity(3.0) < 1.0 < both.severity(1.0)


def made(
    campaign: Campaign, tmp_path: Path, index: int, *, outcome: str = "completed", off: float = 0.1, left: Any = 0.5
) -> Outcome:
    """An outcome of a run of the campaign, with signals in which its fault is noticed at once."""
    path = tmp_path / "signals.parquet"
    if not path.exists():
        write_log(log(WELL, CAPTURES + between(4.0, 6.0)), path)
    numbers: Mapping[str, Any] = {
        "outcome": outcome,
        "off_tracking": {"true_max_m": off},
        "road": {"wheel_clearance_left_m": left},
        "timing": {"simulated_s": 10.0},
    }
    return Outcome(case=campaign.cases()[index], numbers=numbers, signals=path)


def test_a_verdict_names_what_is_broken_and_its_value(campaign: Campaign, tmp_path: Path) -> None:
    """Limits above and below, outcomes, and numbers that are missing; an exception breaks the outcome alone."""
    passed = campaign.judge(made(campaign, tmp_path, 2))
    assert (passed.verdict, passed.reasons, passed.fault) == ("passed", "", "gyro_bias")
    wide = campaign.judge(made(campaign, tmp_path, 2, off=0.8, left=-0.2))
    assert wide.failed
    assert wide.reasons == "off_tracking.true_max_m = 0.8; road.wheel_clearance_left_m = -0.2"
    folded = campaign.judge(made(campaign, tmp_path, 2, outcome="jackknifed"))
    assert folded.reasons == "jackknifed"
    assert failures.badness(folded) > failures.badness(wide) > failures.badness(passed)
    assert campaign.judge(made(campaign, tmp_path, 2, left=None)).reasons == "road.wheel_clearance_left_m = no value"
    broken = campaign.judge(made(campaign, tmp_path, 2, outcome="failed: ValueError: x", off=9.0))
    assert [breach.requirement for breach in broken.breaches] == [END_OF_RUN]


def test_a_fault_that_is_over_before_it_had_to_be_noticed_need_not_be_noticed(
    campaign: Campaign, tmp_path: Path
) -> None:
    """Half a second of a fault, to be noticed within a second; two seconds are too long."""
    write_log(log(WELL, CAPTURES), tmp_path / "signals.parquet")
    outcome = made(campaign, tmp_path, 2)
    assert campaign.judge(outcome).reasons == "time to detect: never"
    axes = (("faults", "gyro_bias:1@4+0.5"), *outcome.case.axes[1:])
    short = Case(scenario="roundabout", fixed=(), axes=axes, seed=1)
    spent = Outcome(case=short, numbers=outcome.numbers, signals=outcome.signals)
    assert not verdict_on(spent, "gyro_bias", campaign.requirements).failed


def test_a_harmless_fault_need_not_be_noticed_if_the_campaign_says_so(campaign: Campaign, tmp_path: Path) -> None:
    """The follow point is 0.3 m off while the fault acts, and 0.6 m before it, which does not count."""
    write_log(log(between(2.0, 3.0, 0.6) + between(4.5, 6.0, 0.3), CAPTURES), tmp_path / "signals.parquet")
    outcome = made(campaign, tmp_path, 2)
    for below, reasons in ((0.0, "time to detect: never"), (0.25, "time to detect: never"), (0.35, "")):
        needed = dataclasses.replace(campaign.requirements, harmless_below=below)
        assert verdict_on(outcome, "gyro_bias", needed).reasons == reasons


def test_runs_that_ended_before_their_fault_are_left_out(campaign: Campaign, tmp_path: Path) -> None:
    outcomes = [made(campaign, tmp_path, k) for k in range(len(campaign.cases()))]
    early = {**outcomes[2].numbers, "timing": {"simulated_s": 3.0}}
    outcomes[2] = Outcome(case=outcomes[2].case, numbers=early, signals=outcomes[2].signals)
    runs = [campaign.judge(outcome) for outcome in outcomes]
    assert runs[2].verdict == "fault not reached"
    cells = {cell.place: cell for cell in failures.cells_of(campaign, runs)}
    assert len(cells["gyro_bias", "", "path_preview"].runs) == 1
    assert len(cells["gyro_bias", "", "mpc"].runs) == 2


def test_probabilities_are_counted_for_each_fault_law_and_requirement(campaign: Campaign, tmp_path: Path) -> None:
    """One of two runs fails: from 1 to 99 %; none of one still allows 97.5 %, more than is accepted."""
    outcomes = [made(campaign, tmp_path, k, off=0.8 if k == 2 else 0.1) for k in range(len(campaign.cases()))]
    runs = [campaign.judge(outcome) for outcome in outcomes]
    cells = failures.cells_of(campaign, runs)
    found = {cell.place: (cell.failing.beyond, cell.failing.runs) for cell in cells}
    assert found["gyro_bias", "", "path_preview"] == (1, 2)
    assert found["wheel_speed_dropout", "", "mpc"] == (0, 1)
    assert {cell.place: len(cell.runs) for cell in failures.totals(cells)} == {
        ("all faults", "", "path_preview"): 3,
        ("all faults", "", "mpc"): 3,
    }
    broken = failures.requirement_failures(campaign, runs)["off_tracking.true_max_m"]
    assert (broken["path_preview"].beyond, broken["mpc"].beyond, broken["mpc"].runs) == (1, 0, 3)
    assert {cell.place for cell in failures.unaccepted(campaign, cells)} == {
        ("gyro_bias", "", "path_preview"),
        ("wheel_speed_dropout", "", "path_preview"),
        ("wheel_speed_dropout", "", "mpc"),
    }


def test_a_law_that_fails_without_a_fault_is_told_first(campaign: Campaign, tmp_path: Path) -> None:
    """Then how often each law fails with a fault, and by how much a fault makes its deviation grow: 0.1 to 0.8 m."""
    cases = campaign.cases()
    faults = [dict(case.axes)["faults"] for case in cases]
    off = [0.9 if k == 1 else 0.8 if fault.startswith("gyro_bias:5") else 0.1 for k, fault in enumerate(faults)]
    runs = [campaign.judge(made(campaign, tmp_path, k, off=one)) for k, one in enumerate(off)]
    assert (runs[1].fault, dict(cases[1].axes)["trailer_steering"]) == ("none", "mpc")
    page = campaign_page("campaign-mine", campaign, runs, failures.cells_of(campaign, runs), (), [""] * len(runs))
    told = re.findall(r"<li>(.*?)</li>", page[: page.index("<h2>")])
    assert told == [
        "Without any fault 1 of 1 run of mpc fail.",
        "path_preview: 1 of 3 runs with a fault fail.",
        "mpc: 1 of 3 runs with a fault fail.",
    ]
    assert {"+70.0 cm", "-10.0 cm", "+50 %", "-50 %"} <= set(re.findall(r'class="number"[^>]*>([^<]*)<', page))
    assert "<h1>mine" in page


def test_medians_count_what_never_came() -> None:
    """Two of three never: so is the median; values that do not apply are left out."""
    assert failures.Times.of([1.0, math.inf, 2.0, math.nan]) == (3, 1, 2.0, math.inf)
    assert failures.Times.of([1.0, math.inf, math.inf]).median == math.inf
    assert math.isnan(failures.Times.of([math.nan]).median)


def amount(case: Case) -> float:
    return float(dict(case.axes)["faults"].partition(":")[2].partition("@")[0])


def test_bisection_finds_the_smallest_value_that_fails(campaign: Campaign, tmp_path: Path) -> None:
    """One law fails from 3.3 on, the other never; every round makes at most a run of each search."""
    rounds = list[list[float]]()

    def make(cases: Sequence[Case]) -> list[Outcome]:
        rounds.append([amount(case) for case in cases])
        fails = [amount(case) >= 3.3 and dict(case.axes)["trailer_steering"] == "mpc" for case in cases]
        outcomes = (made(campaign, tmp_path, 2, off=0.9 if fail else 0.1) for fail in fails)
        return [dataclasses.replace(one, case=case) for one, case in zip(outcomes, cases, strict=True)]

    preview, mpc = failures.bisected(campaign, [], make)
    assert (preview.law, preview.finding, preview.exceptions) == ("path_preview", "never fails", ())
    assert (mpc.law, mpc.finding, mpc.exceptions) == ("mpc", "found", ())
    low, high = mpc.bracket
    assert low < 3.3 <= high <= low + 0.25
    assert rounds[:2] == [[0.0, 0.0], [10.0, 10.0]]
    assert all(len(values) == 1 for values in rounds[2:])
    assert len(rounds) <= 2 + math.ceil(math.log2(10.0 / 0.25))


def test_bisection_says_where_runs_contradict_a_threshold(campaign: Campaign, tmp_path: Path) -> None:
    """All runs of the search pass and one of the campaign failed, at 5; or all fail and one of the campaign passed."""

    def outcome(case: Case, fails: bool) -> Outcome:
        return dataclasses.replace(made(campaign, tmp_path, 2, off=0.9 if fails else 0.1), case=case)

    def outcomes(fails: bool, cases: Sequence[Case]) -> list[Outcome]:
        return [outcome(case, fails) for case in cases]

    runs = [campaign.judge(outcome(case, "gyro_bias:5" in dict(case.axes)["faults"])) for case in campaign.cases()]
    for fails, finding, exceptions in ((False, "never fails", (5.0,)), (True, "always fails", (1.0,))):
        searches = failures.bisected(campaign, runs, partial(outcomes, fails))
        assert [(search.finding, search.exceptions) for search in searches] == [(finding, exceptions)] * 2
    without_numbers = next(entry for entry in campaign.entries if entry.kind == "wheel_speed_dropout")
    timed = searches[0].table.model_copy(update={"of": "duration"})
    shown = [searches[0], dataclasses.replace(searches[0], entry=without_numbers, table=timed)]
    assert [row[0] for row in searches_table(shown).rows] == [
        "gyro_bias: bias [deg/s]",
        "wheel_speed_dropout: duration [s]",
    ]
