"""`offtrack fit-surrogate`: the errors of real camera runs, for environments that train without cameras."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from scenarios.commands.console import one_line_errors

EXAMPLES = "Example: offtrack fit-surrogate runs/roundabout-1 runs/figure-of-eight-1 --out surrogate.toml"


def fit_surrogate(
    runs: Annotated[list[Path], typer.Argument(help="Directories of runs whose off_tracking looked through cameras.")],
    out: Annotated[Path | None, typer.Option(help="File to write the parameters to, with their source.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the parameters as JSON, and nothing else.")] = False,
) -> None:
    """Fit the surrogate of an off-tracking estimator, for environments, to the errors of real runs."""
    from scenarios.environments.fitting import fitted, run_errors, surrogate_toml

    with one_line_errors():
        if out is not None and out.exists():
            raise ValueError(f"{out} exists already: choose another name, or remove it first")
        errors = [run_errors(run) for run in runs]
        parameters = fitted(errors)
        frames = sum(len(run.error) for run in errors)
        if out is not None:
            out.write_text(surrogate_toml(parameters, len(runs), frames), encoding="utf-8")
        if as_json:
            typer.echo(json.dumps(asdict(parameters), indent=2))
        else:
            typer.echo(f"{len(runs)} runs, {frames} frames")
            for name, value in asdict(parameters).items():
                typer.echo(f"  {name:16s} {value:.4g}")
