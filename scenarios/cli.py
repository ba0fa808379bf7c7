"""The `offtrack` command with its subcommands."""

from __future__ import annotations

import importlib.metadata
import sys
from typing import Annotated

import typer

from scenarios.commands import (
    assess,
    calibrate,
    campaign,
    draw,
    estimate,
    export,
    fit_surrogate,
    fmu,
    listing,
    reproduce,
    run,
    study,
    train,
    tune,
    validate,
    vehicle,
    view,
)
from scenarios.commands.console import INTERRUPTED, OneLineGroup, lines
from scenarios.interrupts import TERMINATED, interrupt_on_termination, terminated

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


app.command()(listing.scenarios)
app.command(epilog=lines(listing.PARTS_EXAMPLES))(listing.parts)
app.command(epilog=lines(listing.KEYS_EXAMPLES))(listing.keys)
app.command(epilog=lines(run.EXAMPLES))(run.run)
app.command(epilog=lines(vehicle.EXAMPLES))(vehicle.vehicle)
app.command(epilog=lines(assess.EXAMPLES))(assess.assess)
app.command(epilog=lines(view.EXAMPLES))(view.view)
app.command(epilog=lines(draw.EXAMPLES))(draw.draw)
app.command(epilog=lines(export.EXAMPLES))(export.export)
app.command()(validate.validate)
app.command(epilog=lines(calibrate.EXAMPLES))(calibrate.calibrate)
app.command(epilog=lines(study.COMPARE_EXAMPLES))(study.compare)
app.command(epilog=lines(study.SWEEP_EXAMPLES))(study.sweep)
app.command(epilog=lines(campaign.EXAMPLES))(campaign.campaign)
app.command(epilog=lines(tune.EXAMPLES))(tune.tune)
app.command(epilog=lines(train.EXAMPLES))(train.train)
app.command(name="convert-policy", epilog=lines(train.CONVERT_EXAMPLES))(train.convert_policy)
app.command(epilog=lines(reproduce.EXAMPLES))(reproduce.reproduce)
app.command(name="fit-surrogate", epilog=lines(fit_surrogate.EXAMPLES))(fit_surrogate.fit_surrogate)
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
