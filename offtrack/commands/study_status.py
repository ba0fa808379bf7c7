"""State of a study on the terminal: what is finished, running, waiting and failed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.table import Table

from offtrack.commands.console import PlainConsole

if TYPE_CHECKING:
    from offtrack.studies.study import Study


def print_status(study: Study, directory: Path, *, as_json: bool) -> None:
    """Print the state of a study in its directory.

    Raises:
        ValueError: one line, if the directory holds none, or another one.
    """
    from offtrack.studies.files import check_study_directory
    from offtrack.studies.status import silent_for, status

    if not directory.is_dir():
        raise ValueError(f"{directory}: there is no study yet: leave out --status, or name its --out")
    check_study_directory(directory, study.file)
    now = status(study, directory)
    if as_json:
        numbers = {
            "runs": now.runs,
            "finished": now.finished,
            "failed": [{"run": run, "reason": reason} for run, reason in now.failed],
            "running": [
                {"run": run, "host": claim.host, "process": claim.process, "silent_s": round(silent_for(claim), 1)}
                for run, claim in now.running
            ],
            "waiting": now.waiting,
            "spared": now.spared,
            "mean_s": now.mean_seconds,
            "remaining_s": now.remaining_seconds,
            "machines": list(now.machines),
        }
        typer.echo(json.dumps(numbers, indent=2))
        return
    console = PlainConsole()
    table = Table(title=f"{directory}: {now.runs} runs", title_justify="left")
    for heading in ("finished", "running", "waiting", "failed", "mean [s]", "remaining [s]"):
        table.add_column(heading, justify="right")
    seconds = ["-" if value is None else f"{value:.1f}" for value in (now.mean_seconds, now.remaining_seconds)]
    table.add_row(*map(str, (now.finished, len(now.running), now.waiting, len(now.failed))), *seconds)
    console.print(table)
    if study.stop:
        line = f"[stop] spares {now.spared} draws so far, and may spare more of those that wait"
        console.print(line, markup=False, soft_wrap=True)
    for run, claim in now.running:
        line = f"running: {run} on {claim.host}, process {claim.process}, last sign {silent_for(claim):.0f} s ago"
        console.print(line, soft_wrap=True)
    for run, reason in now.failed:
        console.print(f"failed: {run}: {reason.removeprefix('failed: ')}", soft_wrap=True)
    if len(now.machines) > 1:
        console.print(f"made on {', '.join(now.machines)}", soft_wrap=True)
