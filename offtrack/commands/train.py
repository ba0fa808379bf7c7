"""`offtrack train`, `convert-policy` and `fit-surrogate`: train policies, and fit the errors of camera estimators."""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from offtrack.commands.console import PlainConsole, Quiet, one_line_errors, progress_bar, progress_display
from scenarios.processes import MOST_JOBS
from scenarios.progress import postponed_interrupts

if TYPE_CHECKING:
    from offtrack.environments.training.training_directory import Scores


TRAIN_EXAMPLES = (
    "Examples: offtrack train   offtrack train --observation truth --steps 4000000 --out runs/quick   Then: "
    "offtrack run roundabout --set trailer_steering=policy --set policy.path=runs/train-surrogate-1/policy.npz"
)
_DEFAULT_STEPS = 16_000_000


def train(
    observation: Annotated[
        str, typer.Option(help="Observation of the policy: surrogate (with estimation errors) or truth.")
    ] = "surrogate",
    vehicle: Annotated[
        str, typer.Option(help="Name of a vehicle or a TOML file; its last trailer is steered.")
    ] = "uk_longer_semitrailer",
    steps: Annotated[
        int,
        typer.Option(help="Total number of control steps of 20 ms over all environments, including earlier ones."),
    ] = _DEFAULT_STEPS,
    minutes: Annotated[
        float | None, typer.Option(help="Time limit [min]; training ends earlier once all steps are done.")
    ] = None,
    envs: Annotated[int, typer.Option(help="Number of environments in parallel.")] = 512,
    seed: Annotated[int, typer.Option(help="Seed of networks, noise and episodes.")] = 1,
    episodes: Annotated[int, typer.Option(help="Episodes per condition of the final comparison.")] = 4,
    threads: Annotated[int | None, typer.Option(help="Threads of the learner.", show_default="one per core")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory; an existing training is resumed.", show_default="runs/train-OBSERVATION-SEED"
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON and nothing else.")] = False,
) -> None:
    """Train a policy for offtrack/TrailerSteering-v0 with PPO, and compare it with steering laws.

    After an interrupt the same command resumes from the last checkpoint. Writes policy.npz (for
    trailer_steering=policy), learning_curve.parquet and .png, checkpoint.zip, and summary.json with the comparison on
    courses, frictions and speeds outside the training. Needs the extra rl.
    """
    from vehicle.foundation.quantity import check_number

    with one_line_errors():
        check_number("--steps", steps, 1000, 1e12)
        check_number("--minutes", minutes, 0.05, 1e6, "min")
        check_number("--envs", envs, 1, 100_000)
        check_number("--seed", seed, 0, 2**31)
        check_number("--episodes", episodes, 1, 10_000)
        check_number("--threads", threads, 1, MOST_JOBS)
        _check_extra()
        if observation not in ("surrogate", "truth"):
            raise ValueError(f"--observation {observation}: must be surrogate or truth")
        import torch

        from controllers.trailer_steering.policy import load_network
        from offtrack.environments import registry
        from offtrack.environments.training.evaluation import evaluate
        from offtrack.environments.training.learner import Budget, learn
        from offtrack.environments.training.training_directory import (
            check_directory,
            keep_network,
            keep_summary,
            opened_directory,
            summary,
        )
        from offtrack.environments.training.training_plan import ENVIRONMENT, Plan

        torch.set_num_threads(threads or os.cpu_count() or 1)
        plan = Plan(observation=observation, vehicle=vehicle, envs=envs, seed=seed)
        directory = out or Path("runs") / f"train-{observation}-{seed}"
        check_directory(plan, directory)
        registry.vector(ENVIRONMENT, 1, **plan.environment()).close()  # refuses what can not be trained
        with opened_directory(plan, directory), progress_display(shown=not (quiet or as_json)) as display:
            budget = Budget(steps, None if minutes is None else 60.0 * minutes)
            learned = learn(plan, budget, directory, progress_bar(display, "train"))
            with postponed_interrupts():
                network = keep_network(learned.network, directory)
            scores = evaluate(plan, load_network(network), episodes, progress_bar(display, "compare"))
            command = shlex.join(["offtrack", *sys.argv[1:]])
            result = summary(plan, learned.curve, scores, command)
            keep_summary(result, learned.curve, scores, directory)
    if as_json:
        typer.echo(json.dumps(result, indent=2))
    elif not quiet:
        _print(result, scores, network)


CONVERT_EXAMPLES = (
    "Example: offtrack convert-policy model.zip --out policy.npz   Then: "
    "offtrack run roundabout --set trailer_steering=policy --set policy.path=policy.npz"
)


def convert_policy(
    model: Annotated[Path, typer.Argument(help="File that a model's save() wrote: PPO, A2C, SAC, TD3 or DDPG.")],
    vehicle: Annotated[
        str, typer.Option(help="Name of the vehicle, or its TOML file, that the model was trained with.")
    ] = "uk_longer_semitrailer",
    out: Annotated[
        Path | None, typer.Option(help="File to write; it must not exist yet.", show_default="MODEL with .npz")
    ] = None,
) -> None:
    """Convert a model of stable-baselines3 for trailer_steering=policy.

    The model must have been trained in offtrack/TrailerSteering-v0 with an MlpPolicy, without wrappers that change
    observations or actions. Its mean action becomes the steering law. Pickled objects in the file are not loaded. Needs
    the extra rl.
    """
    with one_line_errors():
        _check_extra()
        from controllers.trailer_steering.policy import save_network
        from offtrack.environments.training.saved_model import saved_network
        from scenarios.results.atomic_files import check_new_file, replacing
        from vehicle.combination.description import load_vehicle

        written = out or model.with_suffix(".npz")
        check_new_file(written)
        network = saved_network(model, load_vehicle(vehicle))
        with replacing(written) as unfinished, unfinished.open("wb") as file:
            save_network(network, file)
        layers = " x ".join(str(len(biases)) for biases in network.biases)
        typer.echo(f"{written}: {len(network.features)} inputs, layers of {layers}, {network.hidden}")


def _check_extra() -> None:
    """Check that the learner is installed.

    Raises:
        ValueError: one line that says how to install it.
    """
    for module in ("stable_baselines3", "torch"):
        if importlib.util.find_spec(module) is None:
            raise ValueError(f"training needs {module}; install it with: pip install 'offtrack[rl]'")


def _print(result: dict[str, Any], scores: Scores, network: Path) -> None:
    title = "Off-tracking of the follow point, RMS (largest) in metres; * ended in a mishap"
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for law in next(iter(scores.values())):
        table.add_column(law, justify="right")
    for name, laws in scores.items():
        marks = [f"{s.rms_m:.3f} ({s.max_m:.2f}){'*' * s.mishaps}" for s in laws.values()]
        table.add_row(name if name == "trained" else f"unseen {name}", *marks)
    console = PlainConsole()
    console.print(f"{result['steps'] / 1e6:.1f} million steps in {result['wall_s'] / 60.0:.1f} min")
    console.print(table)
    run = f"offtrack run roundabout --set trailer_steering=policy --set policy.path={network}"
    console.print(f"Run it: {run}", soft_wrap=True)


FIT_EXAMPLES = "Example: offtrack fit-surrogate runs/roundabout-1 runs/figure-of-eight-1 --out surrogate.toml"


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
    from offtrack.environments.surrogate_fit import fitted, run_errors, surrogate_toml
    from scenarios.results.atomic_files import check_new_file, replaced

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
