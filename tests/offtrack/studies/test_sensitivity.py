"""Sensitivity analyses: designs, indices against closed forms, failed runs, and what is refused."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("SALib")

from offtrack.commands.cli import app
from offtrack.studies.case import Outcome
from offtrack.studies.draws import NOT_COMPLETED, Analysis, analysed
from offtrack.studies.study import Study, load_study
from offtrack.studies.study_page import sensitivity_csv, sensitivity_sections, study_page
from offtrack.studies.table import rows_of

HEAD = 'scenario = "cambered-road"\n[set]\noff_tracking = "truth"\ncourse.length = 20\n'
ISHIGAMI = """[draw]
surface.friction.uniform = [-3.141592653589793, 3.141592653589793]
speed_kmh.uniform = [-3.141592653589793, 3.141592653589793]
"plant.mass_scale".uniform = [-3.141592653589793, 3.141592653589793]
"""
A, B = 7.0, 0.1  # of Ishigami's function


def study(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


def outcomes_of(read: Study, function: Callable[[Mapping[str, float]], float | None]) -> list[Outcome]:
    """Made-up outcomes of the study's own cases; None: the run failed."""
    values = [function({key: float(text) for key, text in case.drawn}) for case in read.cases()]
    ends = ("jackknifed" if value is None else "completed" for value in values)
    numbers = [{"outcome": end, "off_tracking": {"true_rms_m": value}} for end, value in zip(ends, values, strict=True)]
    return [Outcome(case=case, numbers=one) for case, one in zip(read.cases(), numbers, strict=True)]


def ishigami(x: Mapping[str, float]) -> float:
    a, b, c = x["surface.friction"], x["speed_kmh"], x["plant.mass_scale"]
    return math.sin(a) + A * math.sin(b) ** 2 + B * c**4 * math.sin(a)


def by_key(analysis: Analysis) -> dict[str, tuple[float, float, float]]:
    return {index.key: (index.first, index.second, index.first_half_width) for index in analysis.indices}


@pytest.mark.slow
def test_sobol_indices_are_those_of_ishigami(tmp_path: Path) -> None:
    """Closed form: V = a²/8 + b π⁴/5 + b² π⁸/18 + 1/2; the third variable acts by its interaction alone."""
    read = study(tmp_path, HEAD + ISHIGAMI + '[sensitivity]\nmethod = "sobol"\nsamples = 2048\n')
    assert len(read.cases()) == 2048 * 5
    assert study(tmp_path, read.to_toml()).cases() == read.cases()
    assert read.draws.sensitivity is not None
    (analysis,) = analysed(read.draws.sensitivity, outcomes_of(read, ishigami))
    total = A**2 / 8 + B * math.pi**4 / 5 + B**2 * math.pi**8 / 18 + 0.5
    alone = (0.5 * (1 + B * math.pi**4 / 5) ** 2 / total, A**2 / 8 / total, 0.0)
    both = B**2 * math.pi**8 * (1 / 18 - 1 / 50) / total
    found = by_key(analysis)
    for key, first, whole in zip(found, alone, (alone[0] + both, alone[1], both), strict=True):
        assert found[key][0] == pytest.approx(first, abs=0.03)  # of 2048 scrambled points: some 0.01
        assert found[key][1] == pytest.approx(whole, abs=0.03)
        assert abs(found[key][0] - first) < 2.0 * found[key][2] < 0.2  # the interval tells the error's size


def test_elementary_effects_of_a_line_are_its_slopes(tmp_path: Path) -> None:
    """Over the whole range of each key, without deviation; of a normal distribution the range is its central 95 %."""
    draw = "[draw]\nspeed_kmh.uniform = [10, 30]\nsurface.friction.normal = [0.5, 0.1]\n"
    read = study(tmp_path, HEAD + draw + '[sensitivity]\nmethod = "morris"\ntrajectories = 6\n')
    assert len(read.cases()) == 6 * 3
    assert study(tmp_path, read.to_toml()) == read
    made = outcomes_of(read, lambda x: 3.0 - 0.5 * x["speed_kmh"])
    assert read.draws.sensitivity is not None
    (analysis,) = analysed(read.draws.sensitivity, made)
    found = by_key(analysis)
    assert found["speed_kmh"][:2] == pytest.approx((10.0, 0.0), abs=1e-9)
    assert found["surface.friction"][:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert [index.second_half_width for index in analysis.indices] == pytest.approx([0.0, 0.0], abs=1e-9)
    frictions = {float(dict(case.drawn)["surface.friction"]) for case in read.cases()}
    assert min(frictions) == pytest.approx(0.5 - 1.959964 * 0.1, abs=1e-6)


def test_the_interval_of_a_deviation_holds_the_true_one(tmp_path: Path) -> None:
    """Effects of x² over four levels, with steps of two thirds, are 2/3 or 4/3, half each: they deviate by 1/3."""
    draw = "[draw]\nspeed_kmh.uniform = [0, 1]\nsurface.friction.uniform = [0.1, 0.9]\n"
    read = study(tmp_path, HEAD + draw + '[sensitivity]\nmethod = "morris"\ntrajectories = 40\n')
    assert read.draws.sensitivity is not None
    (analysis,) = analysed(read.draws.sensitivity, outcomes_of(read, lambda x: x["speed_kmh"] ** 2))
    (speed,) = (index for index in analysis.indices if index.key == "speed_kmh")
    assert abs(speed.second - 1.0 / 3.0) < speed.second_half_width < 0.1
    answer = study_page(
        "sweep-s", read, outcomes := outcomes_of(read, lambda x: x["speed_kmh"] ** 2), rows_of(outcomes)
    )
    assert "The RMS true off-tracking depends most on speed 96.7 cm, then friction 0.0 mm." in answer


def test_groups_of_failed_runs_are_left_out_and_named(tmp_path: Path) -> None:
    """The others count; failing itself has indices; with hardly any group left there are none."""
    draw = "[draw]\nspeed_kmh.uniform = [10, 30]\nsurface.friction.uniform = [0.1, 0.9]\n"
    read = study(tmp_path, HEAD + draw + '[sensitivity]\nmethod = "morris"\ntrajectories = 20\n')
    design = read.draws.sensitivity
    assert design is not None
    made = outcomes_of(read, lambda x: None if x["surface.friction"] < 0.2 else x["speed_kmh"])
    analysis, failing = analysed(design, made)
    assert 2 <= analysis.groups < 20
    assert by_key(analysis)["speed_kmh"][0] == pytest.approx(20.0)
    assert set(analysis.left_out) == {one.case.title for one in made if not one.completed}
    assert failing.quantity is NOT_COMPLETED
    assert by_key(failing)["surface.friction"][0] > 0.2 > by_key(failing)["speed_kmh"][0] == 0.0
    assert [section.title for section in sensitivity_sections(design, made)][-1] == "Runs left out"
    assert len(sensitivity_csv(design, made).splitlines()) == 1 + 2 * 2
    none = analysed(design, outcomes_of(read, lambda x: None))
    assert [one.indices for one in none] == [()]


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_a_real_study_has_its_indices_in_every_output(tmp_path: Path) -> None:
    text = HEAD + '"surface.roughness" = "none"\n[draw]\nplant.mass_scale.uniform = [0.9, 1.1]\n'
    text += 'speed_kmh.uniform = [40, 50]\n[sensitivity]\nmethod = "morris"\ntrajectories = 2\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    answer = CliRunner().invoke(app, ["sweep", str(tmp_path / "s.toml"), "--json", "--out", str(out), "--jobs", "1"])
    assert answer.exit_code == 0, answer.output
    (row,) = json.loads(answer.output)
    width = next(one for one in row["sensitivity"] if one["quantity"] == "off_tracking.true_rms_m")
    assert width["groups"] == 2
    assert width["keys"]["speed_kmh"]["mu_star"] > 0.0
    assert "plant.mass_scale" in (out / "sensitivity.csv").read_text(encoding="utf-8")
    assert "Elementary effects" in (out / "report.html").read_text(encoding="utf-8")
