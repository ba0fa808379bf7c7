"""Commands killed at a moment that matters; ``make kills`` tries random ones, of all commands."""

import signal
from pathlib import Path

import pytest

from tests.kills.campaign import COMMANDS, STUDY, killed


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_terminated_study_keeps_what_is_finished(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 143 or 129, no worker left after 5 s; the next one makes the other runs only."""
    monkeypatch.setitem(COMMANDS, "sweep", ["sweep", "study.toml", "--jobs", "1", "--out", "out"])
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    found = killed("sweep", number, tmp_path, lambda: any(tmp_path.glob("out/cells/*.json")))
    code, kept, problems = found
    assert (code, problems) == (128 + number, [])
    assert kept >= 1
    assert len(list(tmp_path.glob("out/cells/*.json"))) == 4
