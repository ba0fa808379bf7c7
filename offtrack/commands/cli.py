"""The `offtrack` command with its subcommands, whose modules are imported when they are called."""

import importlib
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperCommand

from offtrack.commands.console import OneLineGroup, join_settings, lines
from scenarios.processes import save_time
from scenarios.progress import end_at_once


class Entry(NamedTuple):
    """A command: where it is, and the line that `offtrack --help` shows of it."""

    module: str  # below offtrack.commands
    help: str
    examples: str = ""  # name of the module's text at the end of the command's help
    function: str = ""  # empty: named as the command, or a group of commands, ``app``


_COMMANDS: Final = {
    "scenarios": Entry("listings", "List all scenarios, or show one in full."),
    "parts": Entry("listings", "List the replaceable parts with their parameters and ranges.", "PARTS_EXAMPLES"),
    "keys": Entry("listings", "List every key of a scenario with its value and meaning.", "KEYS_EXAMPLES"),
    "run": Entry("run", "Run a scenario in the closed loop and write its report.", "RUN_EXAMPLES"),
    "road": Entry("road", "Show what a map or track holds, and how to drive it.", "EXAMPLES"),
    "vehicle": Entry("assess", "Check a vehicle or rover file, and draw its data sheet.", "VEHICLE_EXAMPLES"),
    "assess": Entry("assess", "Drive a vehicle through standard manoeuvres.", "ASSESS_EXAMPLES"),
    "view": Entry("exchange", "Lay finished runs over each other in one page.", "VIEW_EXAMPLES"),
    "draw": Entry("exchange", "Draw the swept path of a finished run for CAD or GIS.", "DRAW_EXAMPLES"),
    "export": Entry("exchange", "Write the signals of a finished run for other tools.", "EXPORT_EXAMPLES"),
    "validate": Entry("assess", "Compare the vehicle model with theory and published tables."),
    "calibrate": Entry("calibrate", "Calibrate cameras with photographs of a checkerboard.", "EXAMPLES"),
    "compare": Entry("study", "Compare steering laws, or finished runs, in a table.", "COMPARE_EXAMPLES"),
    "sweep": Entry("study", "Run every combination of a study's values with every seed.", "SWEEP_EXAMPLES"),
    "campaign": Entry("campaign", "Run a fault campaign: how often a loop fails requirements.", "EXAMPLES"),
    "tune": Entry("train", "Tune the parameters of a steering law or rover driver.", "TUNE_EXAMPLES"),
    "train": Entry("train", "Train a trailer steering policy with PPO.", "TRAIN_EXAMPLES"),
    "benchmark": Entry("benchmark", "Evaluate a policy in a task, beside the baselines.", "EXAMPLES"),
    "convert-policy": Entry("train", "Convert a model of stable-baselines3.", "CONVERT_EXAMPLES", "convert_policy"),
    "reproduce": Entry("assess", "Reproduce a paper's table or figure.", "REPRODUCE_EXAMPLES"),
    "fit-surrogate": Entry("train", "Fit a surrogate of a camera estimator.", "FIT_EXAMPLES", "fit_surrogate"),
    "estimate": Entry("estimate", "Run estimators on recorded images.", function="app"),
    "doctor": Entry("doctor", "Say what works on this machine, and what is missing.", "EXAMPLES"),
    "fmu": Entry("exchange", "Co-simulation with other tools by FMI.", function="app"),
}


class _Commands(Mapping[str, Any]):
    """The commands by name; the first look at one imports its module."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            self._loaded[name] = self._load(name, _COMMANDS[name])
        return self._loaded[name]

    @staticmethod
    def _load(name: str, entry: Entry) -> Any:
        module = importlib.import_module(f"offtrack.commands.{entry.module}")
        if entry.function == "app":
            return typer.main.get_command(module.app)
        command = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        epilog = lines(getattr(module, entry.examples)) if entry.examples else None
        command.command(name=name, epilog=epilog)(getattr(module, entry.function or name))
        return typer.main.get_command(command)

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


class _Group(OneLineGroup):
    """Commands of a table; a list of them imports none."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.commands: Any = _Commands()

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands."""
        return list(_COMMANDS)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Completions, the commands of which are told without importing them."""
        loaded = self.commands
        self.commands = {name: TyperCommand(name, help=entry.help) for name, entry in _COMMANDS.items()}
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self.commands = loaded

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each command."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.help) for name, entry in _COMMANDS.items()])


app = typer.Typer(
    name="offtrack",
    cls=_Group,
    no_args_is_help=True,
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
        import importlib.metadata  # takes longer than the list of commands

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


def main() -> None:
    """Entry point of the command."""
    save_time()
    join_settings()
    end_at_once()
    app()


if __name__ == "__main__":
    main()
