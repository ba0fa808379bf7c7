"""`offtrack reproduce`: what is made, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from matplotlib.figure import Figure
from typer.testing import CliRunner

from estimators.context import RoverContext
from estimators.estimates import SlipAngle, lost_slip
from offtrack.commands import assess
from offtrack.commands.assess import reproduce
from offtrack.studies.reproduce import reproduction, trace_tables
from offtrack.studies.reproduce.reproduction import (
    REPRODUCTIONS,
    Comparison,
    Reproduction,
    maker,
    names_of,
    printed,
)
from offtrack.studies.reproduce.trace_tables import TraceSet, evaluated, trace_log
from scenarios.progress import Progress
from scenarios.results.log import Log, Signal, read_log
from sensors.messages import RoverView

APP = typer.Typer(pretty_exceptions_enable=False)
APP.command()(reproduce)


@pytest.mark.slow
def test_table_2_writes_picture_data_and_numbers(tmp_path: Path) -> None:
    """Ten candidates beside ten published ones, best first; the confidences spread as widely as the paper's."""
    out = tmp_path / "made"
    result = CliRunner().invoke(APP, ["reina2008-table2", "--quick", "--json", "--out", str(out)])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    written = json.loads((out / "reina2008-table2.json").read_text())
    assert told["numbers"] == written["numbers"]
    assert [float(one["published"]) for one in told["numbers"]] == sorted(
        printed("reina2008")["table2"]["confidences"], reverse=True
    )
    own = [one["own"] for one in told["numbers"] if one["own"] is not None]
    assert own == sorted(own, reverse=True)
    assert own[0] > 80.0  # the trace is clear, and followed from image to image
    assert own[-1] < 50.0  # other candidates are not the trace
    data = read_log(out / "reina2008-table2.parquet")
    assert 100.0 * np.sort(data["confidence"])[::-1] == pytest.approx(own)
    assert (out / "reina2008-table2.png").stat().st_size > 5_000


def test_sets_have_the_papers_numbers_of_images() -> None:
    """Table III: 1560 images of set A and 3456 of set B, 5016 in all."""
    sets = [TraceSet(**one) for one in printed("reina2008")["table3"]["sets"]]
    assert [len(one.kinds) * len(one.seeds) * one.frames for one in sets[:2]] == [1560, 3456]


@pytest.mark.slow
def test_trace_sets_are_counted_apart_and_every_image_is_kept() -> None:
    """Two short ones with a tracker of one's own that sees no trace anywhere: nothing false, everything missed."""
    short = TraceSet(name="short", kinds=("uniform",), seeds=(101,), frames=4, profile="none", slope_deg=0.0)
    steps: list[tuple[float, float, str]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trace_tables, "default_jobs", lambda: 1)
        sets = (short, replace(short, name="longer", frames=6))
        data = trace_log(evaluated(sets, f"{__name__}:Blind", lambda *step: steps.append(step)))
    assert data["frame"].tolist() == [*range(4), *range(6)]
    assert data["set"].tolist() == [0] * 4 + [1] * 6
    assert not data["detected"].any()
    assert steps[-1][:2] == (10, 10)


class Blind:
    @classmethod
    def of(cls, context: RoverContext) -> Blind:
        return cls()

    def init(self) -> None:
        """Nothing to remember."""

    def step(self, memory: None, view: RoverView) -> tuple[None, SlipAngle]:
        return None, lost_slip(view.tick)


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_every_entry_of_the_catalogue_can_be_loaded(name: str) -> None:
    assert callable(maker(name))
    assert name in names_of("all")


@pytest.mark.parametrize(("kept", "folders"), [(True, 2), (False, 1)])
def test_interrupt_of_all_keeps_what_is_finished_and_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: bool, folders: int
) -> None:
    """Ctrl-C in the second figure: the first is there, of the second what is finished, and no third is begun."""
    begun: list[str] = []

    def made(name: str) -> reproduction.Maker:
        def make(quick: bool, progress: Progress) -> Reproduction:
            begun.append(name)
            if len(begun) == 2 and not kept:
                raise KeyboardInterrupt
            return Reproduction(
                name=name,
                title="a figure",
                source="a paper",
                comparisons=[Comparison(quantity="a number", published="1", own=2.0, unit="-")],
                notes=(),
                data=Log((Signal("time", "s", "time"),), np.zeros((1, 1))),
                draw=Figure,
                interrupted=len(begun) == 2,
            )

        return make

    monkeypatch.setattr(assess, "maker", made)
    result = CliRunner().invoke(APP, ["all", "--quiet", "--out", str(tmp_path)])
    assert result.exit_code == 130
    assert begun == list(REPRODUCTIONS)[:2]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(begun[:folders])
    marks = [json.loads((tmp_path / name / f"{name}.json").read_text())["interrupted"] for name in begun[:folders]]
    assert marks == [False, True][:folders]
    again = CliRunner().invoke(APP, ["all", "--json", "--out", str(tmp_path)])
    assert again.exit_code == 0, again.stderr
    assert begun[2:] == list(REPRODUCTIONS)[1:]  # the unfinished one, and the others
    assert [one["name"] for one in json.loads(again.stdout)] == list(REPRODUCTIONS)
    assert again.stderr.count("\n") == 1
    assert "finished earlier" in again.stderr
