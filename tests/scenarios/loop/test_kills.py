"""Commands killed at a moment that matters; ``make kills`` tries random ones, of all commands."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.kills.campaign import COMMANDS, killed, prepare


@pytest.mark.slow
def test_a_terminated_study_keeps_what_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit code 143, no worker left after 5 s; the next one makes the other runs only."""
    monkeypatch.setitem(COMMANDS, "sweep", ["sweep", "study.toml", "--jobs", "1", "--out", "out"])
    prepare(tmp_path)
    finding = killed("sweep", signal.SIGTERM, tmp_path, lambda: any(tmp_path.glob("out/cells/*.json")))
    assert finding.code == 128 + signal.SIGTERM
    assert finding.kept >= 1
    assert finding.problems == []
    assert len(list(tmp_path.glob("out/cells/*.json"))) == 4
