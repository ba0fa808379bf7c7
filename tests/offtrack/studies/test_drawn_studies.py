"""Studies with drawn values: distributions, samples, intervals and what the report says of them."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, kstest, lognorm, norm
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.studies.case import Outcome
from offtrack.studies.draws import made_in_batches
from offtrack.studies.study import Study, load_study
from offtrack.studies.table import Exceeding, running_mean

HEAD = 'scenario = "cambered-road"\nseeds = [1, 2]\n[set]\noff_tracking = "truth"\ncourse.length = 20\n'
SAMPLE = '[sample]\ncount = {count}\nmethod = "{method}"\nseed = 3\n'
DRAW = """[draw]
surface.friction = { uniform = [0.3, 0.9] }
speed_kmh = { normal = [50, 5] }
surface.cross_fall.lognormal = [0.02, 0.3]
trailer_steering.choice = ["none", "command_steer"]
"""


def study(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


@pytest.mark.parametrize("method", ["latin", "sobol", "random"])
def test_draws_have_their_distributions(tmp_path: Path, method: str) -> None:
    """Kolmogorov-Smirnov against the distributions; the same file draws the same; a choice is drawn evenly."""
    read = study(tmp_path, HEAD + SAMPLE.format(count=512, method=method) + DRAW)
    cases = read.cases()
    assert len(cases) == 512
    assert [case.seed for case in cases[:4]] == [1, 2, 1, 2]
    values = {key: [dict(case.drawn)[key] for case in cases] for key, _ in cases[0].drawn}
    keys = ("surface.friction", "speed_kmh", "surface.cross_fall")
    friction, speed, fall = (np.array(values[key], dtype=float) for key in keys)
    assert kstest((friction - 0.3) / 0.6, "uniform").pvalue > 0.01
    assert kstest(speed, norm(50.0, 5.0).cdf).pvalue > 0.01
    assert kstest(fall, lognorm(0.3, scale=0.02).cdf).pvalue > 0.01
    assert values["trailer_steering"].count("none") == pytest.approx(256, abs=40)
    assert study(tmp_path, read.to_toml()).cases() == cases


@pytest.mark.parametrize("method", ["latin", "sobol"])
def test_latin_and_sobol_fill_every_part_of_a_range(tmp_path: Path, method: str) -> None:
    """One value in each of as many equal parts."""
    read = study(tmp_path, HEAD + SAMPLE.format(count=64, method=method) + DRAW)
    friction = np.array([float(dict(case.drawn)["surface.friction"]) for case in read.cases()])
    assert len(set(np.floor((friction - 0.3) / 0.6 * 64).astype(int))) == 64


def test_intervals_are_those_of_clopper_and_pearson() -> None:
    """At its ends the probability of as many or as few is 2.5 %; no failure in 300 runs still allows 1.2 %."""
    low, high = Exceeding(7, 50).interval()
    assert binom.sf(6, 50, low) == pytest.approx(0.025, rel=1e-6)
    assert binom.cdf(7, 50, high) == pytest.approx(0.025, rel=1e-6)
    assert Exceeding(0, 300).interval()[0] == 0.0
    assert Exceeding(0, 300).interval()[1] == pytest.approx(0.0122, abs=1e-4)
    assert Exceeding(5, 5).interval()[1] == 1.0


def test_the_interval_of_the_mean_holds_as_often_as_it_says() -> None:
    """95 % of 2000 samples of 20 values."""
    means = [running_mean(sample) for sample in np.random.default_rng(1).normal(3.0, 2.0, (2000, 20))]
    assert np.mean([abs(mean[-1] - 3.0) < half[-1] for mean, half in means]) == pytest.approx(0.95, abs=0.015)


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_a_drawn_study_runs_and_reports(tmp_path: Path) -> None:
    text = HEAD.replace("[set]", '[set]\nsurface.roughness = "none"') + SAMPLE.format(count=2, method="latin")
    path = tmp_path / "study.toml"
    path.write_text(text + "[draw]\nspeed_kmh.uniform = [40, 60]\n[limits]\ntyres.friction_used_max = 0.0\n", "utf-8")
    arguments = ["sweep", str(path), "--jobs", "1", "--out", str(tmp_path / "out"), "--json", "--quiet"]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    (row,) = json.loads(answer.stdout)
    assert (row["axes"], row["runs"], row["completed"]) == ({}, 2, 2)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for words in ("speed_kmh: uniform 40.0, 60.0", "2 draws (latin, seed 3)", "tyres.friction_used_max", "Convergence"):
        assert words in page
    assert (tmp_path / "out" / "runs.csv").read_text(encoding="utf-8").startswith('"speed_kmh","seed","outcome"')


def test_a_point_ends_when_its_interval_is_narrow(tmp_path: Path) -> None:
    """Nothing beyond the limit is known within 2.5 % after 80 draws; a share of a half is not within 400."""
    text = HEAD + SAMPLE.format(count=400, method="random") + "[draw]\nsurface.friction.uniform = [0.3, 0.9]\n"
    text += "[vary]\nspeed_kmh = [30, 50]\n[limits]\noff_tracking.true_max_m = 0.3\n"
    read = study(tmp_path, text + "[stop]\nhalf_width = 0.025\nbatch = 40\n")
    assert study(tmp_path, read.to_toml()) == read
    cases, asked = read.cases(), list[int]()
    assert read.stop is not None

    def make(chosen: Sequence[int]) -> list[Outcome]:
        asked.extend(chosen)
        worst = [0.6 * (k % 2) if cases[k].axes == cases[0].axes else 0.1 for k in chosen]
        numbers = ({"outcome": "completed", "off_tracking": {"true_max_m": one}} for one in worst)
        return [Outcome(case=cases[k], numbers=one) for k, one in zip(chosen, numbers, strict=True)]

    outcomes = made_in_batches(cases, read.intervals, read.stop, make)
    made = [sum(one.case.axes == axes for one in outcomes) for axes in (cases[0].axes, cases[-1].axes)]
    assert made == [400, 80]
    assert len(asked) == len(set(asked)) == 480
    # 80 is the first multiple of 40 that is enough
    for count, narrow in ((40, False), (80, True)):
        low, high = Exceeding(0, count).interval()
        assert (high - low <= 0.05) == narrow
    assert [outcome.case for outcome in outcomes] == [cases[k] for k in sorted(asked)]
