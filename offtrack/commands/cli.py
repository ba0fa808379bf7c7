"""The `offtrack` command with its subcommands."""

from __future__ import annotations

import importlib.metadata
import sys
from typing import Annotated

import typer

from offtrack.commands import calibrate, campaign, estimate, export, fmu, run, study, train, tune, validate, vehicle
from offtrack.commands.console import INTERRUPTED, OneLineGroup, lines
from scenarios.progress import TERMINATED, interrupt_on_termination, terminated

app = typer.Typer(
    name="offtrack",
    cls=OneLineGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help=(
        "Closed-loop co-simulation of slipping vehicles with camera-based steering.\n\n"
        "Start with: offtrack run roundabout. It drives a long semitrailer round a 12.5 m circle. A stereo camera on "
        "its roof estimates the off-tracking that the trailer steering needs. Report, video and signals are written to "
        "runs/roundabout-1."
    ),
)


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"offtrack {importlib.metadata.version('offtrack')}")
        raise typer.Exit


@app.callback()
def _offtrack(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Print the whole trace of an error; also after the command's name.")
    ] = False,
) -> None:
    """Closed-loop co-simulation of slipping vehicles with camera-based steering."""


app.command()(run.scenarios)
app.command(epilog=lines(run.PARTS_EXAMPLES))(run.parts)
app.command(epilog=lines(run.KEYS_EXAMPLES))(run.keys)
app.command(epilog=lines(run.RUN_EXAMPLES))(run.run)
app.command(epilog=lines(vehicle.VEHICLE_EXAMPLES))(vehicle.vehicle)
app.command(epilog=lines(vehicle.ASSESS_EXAMPLES))(vehicle.assess)
app.command(epilog=lines(export.VIEW_EXAMPLES))(export.view)
app.command(epilog=lines(export.DRAW_EXAMPLES))(export.draw)
app.command(epilog=lines(export.EXPORT_EXAMPLES))(export.export)
app.command()(validate.validate)
app.command(epilog=lines(calibrate.EXAMPLES))(calibrate.calibrate)
app.command(epilog=lines(study.COMPARE_EXAMPLES))(study.compare)
app.command(epilog=lines(study.SWEEP_EXAMPLES))(study.sweep)
app.command(epilog=lines(campaign.EXAMPLES))(campaign.campaign)
app.command(epilog=lines(tune.EXAMPLES))(tune.tune)
app.command(epilog=lines(train.TRAIN_EXAMPLES))(train.train)
app.command(name="convert-policy", epilog=lines(train.CONVERT_EXAMPLES))(train.convert_policy)
app.command(epilog=lines(validate.REPRODUCE_EXAMPLES))(validate.reproduce)
app.command(name="fit-surrogate", epilog=lines(train.FIT_EXAMPLES))(train.fit_surrogate)
app.add_typer(estimate.app, name="estimate")
app.add_typer(fmu.app, name="fmu")


def main() -> None:
    """Entry point of the command."""
    interrupt_on_termination()
    try:
        app()
    except SystemExit as end:
        if end.code == INTERRUPTED and terminated():
            sys.exit(TERMINATED)
        raise


if __name__ == "__main__":
    main()
