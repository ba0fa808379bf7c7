"""`offtrack fit-surrogate`: fit a model of camera estimation errors, for environments without cameras."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from scenarios.commands.console import one_line_errors

EXAMPLES = "Example: offtrack fit-surrogate runs/roundabout-1 runs/figure-of-eight-1 --out surrogate.toml"


def fit_surrogate(
    runs: Annotated[list[Path], typer.Argument(help="Run directories whose off-tracking estimates came from cameras.")],
    out: Annotated[
        Path | None, typer.Option(help="Output file for the parameters and their source; it must not exist yet.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the parameters as JSON and nothing else.")] = False,
) -> None:
    """Fit a surrogate of an off-tracking estimator to the errors of camera runs.

    Environments with observation=surrogate use it to train without cameras.
    """
    from scenarios.environments.fitting import fitted, run_errors, surrogate_toml
    from scenarios.results.files import check_new_file, replaced

    with one_line_errors():
        if out is not None:
            check_new_file(out)
        errors = [run_errors(run) for run in runs]
        parameters = fitted(errors)
        frames = sum(len(run.error) for run in errors)
        if out is not None:
            replaced(out, surrogate_toml(parameters, len(runs), frames))
        if as_json:
            typer.echo(json.dumps(asdict(parameters), indent=2))
        else:
            typer.echo(f"{len(runs)} runs, {frames} frames")
            for name, value in asdict(parameters).items():
                typer.echo(f"  {name:16s} {value:.4g}")
