"""`offtrack tune`, `train`, `convert-policy` and `fit-surrogate`: parameters, policies and error models from runs."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from controllers.trailer_steering.policy import feature_names
from offtrack.commands import console as ui
from offtrack.commands.benchmark import plain_rows, print_results
from offtrack.environments import registry
from offtrack.environments.rewards import DEFAULT_VEHICLE
from offtrack.environments.tasks import EPISODES, task_of
from offtrack.environments.training import training_directory
from offtrack.environments.training.benchmark import (
    Evaluation,
    evaluated,
    header,
    shipped_results,
    summary,
    write_results,
)
from offtrack.studies import tuning as search
from offtrack.studies.pool import RunOptions, run_cases
from offtrack.studies.rehearsal import rehearse, time_text
from offtrack.studies.run_study import CELLS, check_study_directory, opened_study, own_directory
from offtrack.studies.study import subject_of
from scenarios.assembly.surrogate import fitted, run_errors, surrogate_toml
from scenarios.extras import check_extra
from scenarios.processes import MOST_JOBS, default_jobs
from scenarios.progress import postponed_interrupts
from scenarios.results.run_directory import check_new_file, new_run_directory, replaced
from vehicle.combination.description import load_vehicle
from vehicle.foundation.quantity import check_number
from vehicle.foundation.user_file import FileKind, read_text

TRAIN_EXAMPLES = (
    "Examples: offtrack train   offtrack train --observation truth --steps 4000000 --out runs/quick   "
    "offtrack train --task roundabouts-driver --minutes 10   offtrack train --task gate --algorithm sac   Then: "
    "offtrack run roundabout --set trailer_steering=policy --set policy.path=runs/train-surrogate-1/policy.npz"
)
_DEFAULT_STEPS = 16_000_000
_PPO_ENVS, _SAC_ENVS = 512, 32


def train(
    task: Annotated[str, typer.Option(help="Task of the benchmark (see: offtrack benchmark).")] = "paths",
    algorithm: Annotated[str, typer.Option(help="Algorithm of stable-baselines3: ppo or sac.")] = "ppo",
    observation: Annotated[
        str, typer.Option(help="Observation of the policy: surrogate (with estimation errors) or truth.")
    ] = "surrogate",
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Name of a vehicle or a TOML file; its last trailer is steered.", show_default=DEFAULT_VEHICLE
        ),
    ] = None,
    steps: Annotated[
        int, typer.Option(help="Total number of control steps of 20 ms over all environments, including earlier ones.")
    ] = _DEFAULT_STEPS,
    minutes: Annotated[
        float | None, typer.Option(help="Time limit [min]; training ends earlier once all steps are done.")
    ] = None,
    envs: Annotated[
        int | None, typer.Option(help="Number of environments in parallel.", show_default="512; sac: 32")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of networks, noise and episodes.")] = 1,
    episodes: Annotated[int, typer.Option(help="Number of episodes of the final comparison.")] = EPISODES,
    threads: Annotated[int | None, typer.Option(help="Threads of the learner.", show_default="one per core")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory; an existing training is resumed.",
            show_default="runs/train-TASK-ALGORITHM-SEED",
        ),
    ] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Train a policy with PPO or SAC for a task of the benchmark, and compare it with the laws or drivers there.

    After an interrupt the same command resumes from the last checkpoint. Writes policy.npz (of a trailer: for
    trailer_steering=policy), learning_curve.parquet and .png, checkpoint.zip, benchmark.json with the results in the
    benchmark, and summary.json. Needs the extra rl.
    """
    check_number("--steps", steps, 1000, 1e12)
    check_number("--minutes", minutes, 0.05, 1e6, "min")
    check_number("--envs", envs, 1, 100_000)
    check_number("--seed", seed, 0, 2**31)
    check_number("--episodes", episodes, 1, 10_000)
    check_number("--threads", threads, 1, MOST_JOBS)
    check_extra("rl", "training needs", "stable_baselines3", "torch")
    if observation not in ("surrogate", "truth"):
        raise ValueError(f"--observation {observation}: must be surrogate or truth")
    if algorithm not in get_args(training_directory.Algorithm):
        raise ValueError(f"--algorithm {algorithm}: must be ppo or sac")
    if task_of(task).role != "trailer" and vehicle is not None:
        raise ValueError(f"--vehicle {vehicle}: task {task} has a vehicle of its own")
    import torch

    from offtrack.environments.training.learner import Budget, learn

    torch.set_num_threads(threads or os.cpu_count() or 1)
    plan = training_directory.Plan(
        observation=observation,
        vehicle=vehicle,
        envs=envs or (_SAC_ENVS if algorithm == "sac" else _PPO_ENVS),
        seed=seed,
        task=task,
        algorithm=cast(training_directory.Algorithm, algorithm),
    )
    directory = out or Path("runs") / f"train-{task}-{algorithm}-{seed}"
    network = directory / training_directory.NETWORK
    training_directory.check_directory(plan, directory)
    registry.vector(plan.name, 1, **plan.environment()).close()  # refuses what can not be trained
    with (
        training_directory.opened_directory(plan, directory),
        ui.progress_display(shown=not (quiet or as_json)) as display,
    ):
        budget = Budget(steps, None if minutes is None else 60.0 * minutes)
        learned, curve = learn(plan, budget, directory, ui.progress_bar(display, "train"))
        with postponed_interrupts():
            training_directory.keep_network(learned, network)
        # Results of another vehicle are not shipped.
        rows = [] if vehicle else shipped_results(task)
        seen = None if task_of(task).observation is None else observation
        for policy in (*(("none", "command_steer", "path_preview") if vehicle else ()), str(network)):
            asked = Evaluation(task, policy, seen, vehicle)
            rows.append(evaluated(asked, header(asked), episodes, ui.progress_bar(display, "compare")))
        write_results(rows[-1], directory / training_directory.RESULTS)
        results = {"success": summary(rows[-1])["success"].mean, "benchmark": plain_rows(rows)}
        result = training_directory.keep_summary(plan, curve, results, directory)
    if as_json:
        typer.echo(json.dumps(result, indent=2))
    elif not quiet:
        print_results(task, rows)
        console = ui.PlainConsole()
        console.print(f"{result['steps'] / 1e6:.1f} million steps in {result['wall_s'] / 60.0:.1f} min: {network}")
        if task_of(task).role == "trailer":
            run = f"offtrack run roundabout --set trailer_steering=policy --set policy.path={network}"
            run += f" --set vehicle={vehicle}" if vehicle else ""
            console.print(f"Run it: {run}", soft_wrap=True)


CONVERT_EXAMPLES = (
    "Example: offtrack convert-policy model.zip --out policy.npz   Then: "
    "offtrack run roundabout --set trailer_steering=policy --set policy.path=policy.npz"
)


def convert_policy(
    model: Annotated[Path, typer.Argument(help="File that a model's save() wrote: PPO, A2C, SAC, TD3 or DDPG.")],
    vehicle: Annotated[
        str, typer.Option(help="Name of the vehicle, or its TOML file, that the model was trained with.")
    ] = DEFAULT_VEHICLE,
    speed_kmh: Annotated[
        str,
        typer.Option(
            metavar="LOW,HIGH",
            help="Speeds that the model was trained for [km/h]; at others path_preview steers.",
        ),
    ] = "5,20",
    out: Annotated[
        Path | None, typer.Option(help="File to write; it must not exist yet.", show_default="MODEL with .npz")
    ] = None,
) -> None:
    """Convert a model of stable-baselines3 for trailer_steering=policy.

    The model must have been trained in offtrack/TrailerSteering-v0 with an MlpPolicy, without wrappers that change
    observations or actions. Its mean action becomes the steering law. Pickled objects in the file are not loaded. Needs
    the extra rl.
    """
    check_extra("rl", "training needs", "stable_baselines3", "torch")
    from offtrack.environments.training.learner import saved_network

    written = out or model.with_suffix(".npz")
    check_new_file(written)
    trained = load_vehicle(vehicle)
    steered = len(trained.units[-1].steered_axles)
    names = feature_names(steered, [unit.name for unit in trained.units])
    domain = training_directory.trained_for(
        trained, replace(training_directory.DEFAULT_DOMAIN, speed=_speeds(speed_kmh))
    )
    network = saved_network(model, names, steered, domain)
    training_directory.keep_network(network, written)
    layers = " x ".join(str(len(biases)) for biases in network.biases)
    typer.echo(f"{written}: {len(network.features)} inputs, layers of {layers}, {network.hidden}")


def _speeds(text: str) -> tuple[float, float]:
    """Least and largest speed [m/s] of a text in km/h."""
    try:
        low, high = (float(part) / 3.6 for part in text.split(","))
    except ValueError:
        raise ValueError(f"--speed-kmh {text}: expected two numbers LOW,HIGH in km/h, such as 5,20") from None
    if not 0.0 <= low < high <= 40.0:
        raise ValueError(f"--speed-kmh {text}: must be LOW,HIGH with 0 <= LOW < HIGH <= 144 km/h")
    return low, high


FIT_EXAMPLES = "Example: offtrack fit-surrogate runs/roundabout-1 runs/figure-of-eight-1 --out surrogate.toml"


def fit_surrogate(
    runs: Annotated[list[Path], typer.Argument(help="Run directories whose off-tracking estimates came from cameras.")],
    out: Annotated[
        Path | None, typer.Option(help="Output file for the parameters and their source; it must not exist yet.")
    ] = None,
    as_json: ui.AsJson = False,
) -> None:
    """Fit a surrogate of an off-tracking estimator to the errors of camera runs.

    Environments with observation=surrogate use it to train without cameras.
    """
    if out is not None:
        check_new_file(out)
    errors = [run_errors(run) for run in runs]
    parameters = fitted(errors)
    frames = sum(len(run.error) for run in errors)
    if out is not None:
        replaced(out, surrogate_toml(parameters, len(runs), frames))
    if as_json:
        typer.echo(json.dumps(parameters.model_dump(), indent=2))
    else:
        typer.echo(f"{len(runs)} runs, {frames} frames")
        for name, value in parameters.model_dump().items():
            typer.echo(f"  {name:16s} {value:.4g}")


TUNE_EXAMPLES = (
    "Examples: offtrack tune roundabout --controller path_preview --trials 40   "
    "offtrack tune rover-slope --set slip_estimator=truth --trials 10   "
    "offtrack tune roundabout-low-friction --controller path_preview --trials 100 "
    "--objectives off_tracking.true_rms_m,steer.max_rate_deg_s --vary surface.friction=0.8,0.2 "
    "--judge-vary surface.friction=0.5,0.3   Then: offtrack run runs/tune-roundabout-path_preview-1/tuned.toml"
)
_FILE = "tuning.toml"  # identifies the task of a directory


def tune(
    scenario: ui.ScenarioName,
    controller: Annotated[
        str | None,
        typer.Option(
            help="Trailer steering law or rover driver, or package.module:Name.", show_default="path_preview; path"
        ),
    ] = None,
    trials: Annotated[int, typer.Option(help="Total number of finished trials, including earlier ones.")] = 40,
    objectives: Annotated[
        str | None,
        typer.Option(
            help="Comma-separated summary metrics to minimise.",
            show_default="true_rms_m and true_max_m of off_tracking; slip.cross_track_rms_m",
        ),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="NAME=LOW:HIGH",
            help="Parameter to tune, with its range; by default those that the law declares. May be repeated.",
        ),
    ] = None,
    settings: ui.SettingsOfAll = None,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE,…", help="Axis of the grid of tuning runs. May be repeated.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="Seeds of the tuning runs.")] = "101,102",
    judge_vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE,…", help="Axis of the grid of judging runs. May be repeated.", show_default="as --vary"
        ),
    ] = None,
    judge_seeds: Annotated[str, typer.Option(help="Seeds of the judging runs.")] = "1-3",
    jobs: Annotated[
        int | None,
        typer.Option(help="Number of parallel trials; only 1 repeats a search.", show_default="one per core"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the search.")] = 1,
    storage: Annotated[
        str | None,
        typer.Option(
            envvar="OFFTRACK_STORAGE",
            metavar="URL",
            help="Keep the trials in a database that machines share, postgresql://USER@HOST/DATABASE, in place of the "
            "journal. The same command on each machine, with its own --out, works on the same trials.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory; an existing study is resumed.",
            show_default="runs/tune-SCENARIO-LAW-N; the same study's own",
        ),
    ] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Tune the parameters of a trailer steering law or rover driver on some runs, and judge them on others.

    Finished trials are saved at once: repeat the command to continue an interrupted search. Writes tuned.toml (a
    scenario to run), journal.log (without --storage), trials.csv, and report.html with the trade-off between the
    objectives.
    """
    check_number("--trials", trials, 1, 100_000)
    check_number("--jobs", jobs, 1, MOST_JOBS)
    check_number("--seed", seed, 0, 2**31)
    check_extra("tune", "tuning needs", "optuna")
    from offtrack.studies.trials import JOURNAL, database, finished, former, importances, in_database, optimise

    sets = ((vary or [], seeds), (judge_vary or vary or [], judge_seeds))
    tuning = search.tuning_of(scenario, controller, objectives, ranges or [], settings or [], sets)
    controller, workers = tuning.law, jobs or default_jobs()
    sides = (tuning.tuned_on, tuning.judged_on)
    identity = " ".join(study.identity() for study in sides)
    title = f"tune-{Path(scenario).stem}-{controller.rpartition(':')[2]}"
    directory = out or own_directory(
        title, _FILE, lambda file: read_text(file, FileKind.RECORD) == search.description(tuning), identity
    )
    if not (directory / JOURNAL).is_file():
        check_study_directory(directory, _FILE)
    if os.path.lexists(directory / _FILE) and read_text(directory / _FILE, FileKind.RECORD) != search.description(
        tuning
    ):
        raise ValueError(
            f"{directory / _FILE} belongs to another tuning task: choose another --out, or the same options"
        )
    if storage is not None:
        database(storage)  # refuses one that does not answer
        tuning = in_database(tuning, storage)
    unusable = former(tuning, directory)
    with ui.continuable(), ui.progress_display(shown=not (quiet or as_json)) as bar:
        cases = [case for study in sides for case in study.cases()]
        count = trials * len(tuning.tuned_on.cases()) + 2 * len(tuning.judged_on.cases())
        seconds = rehearse(cases, ui.progress_bar(bar, "check"), elsewhere=False, runs=count)
    if not (out or directory.exists()):
        directory = new_run_directory(title)
    if not (quiet or as_json):
        needed = f", about {time_text(seconds / workers)} in all" if seconds else ""
        ui.remark(
            f"{trials} trials of {len(tuning.tuned_on.cases())} runs, {workers} at a time{needed}; in {directory}"
        )
    with ui.continuable(), opened_study(directory, _FILE, search.description(tuning), "" if out else identity):
        if unusable:
            ui.remark(f"{unusable} earlier trials are not used: the law, a file or offtrack has changed since")
        with ui.progress_display(shown=not (quiet or as_json)) as bar:
            progress = ui.progress_bar(bar, f"tune {controller}")
            try:
                results = optimise(tuning, directory, trials=trials, jobs=workers, seed=seed, progress=progress)
            except KeyboardInterrupt:
                kept = min(trials, len(finished(tuning, directory)))
                raise KeyboardInterrupt(f"{kept} of {trials} trials are kept in {directory}") from None
            progress(trials, trials)
            best, compared = search.chosen(results), {}
            candidates = {"defaults": {}, "tuned": best.parameters}
            comparing = ui.progress_bar(bar, "compare")
            for done, (name, parameters) in enumerate(candidates.items()):
                comparing(done, len(candidates))
                cases = search.with_parameters(tuning.judged_on, parameters).cases()
                outcomes = run_cases(cases, directory / CELLS, RunOptions(jobs=workers, remark=ui.remark))
                compared[name] = search.objective_means(tuning.objectives, outcomes)
            comparing(len(candidates), len(candidates))
        search.write_result(tuning, results, best, directory)
        page = search.tuning_page(tuning, results, best, compared, importances(tuning, directory))
        replaced(directory / "report.html", page)
    if as_json:
        result = {
            "law": tuning.law,
            "parameters": dict(best.parameters),
            "tuned_on": dict(zip(tuning.objectives, best.values, strict=True)),
            "judged": {name: dict(zip(tuning.objectives, values, strict=True)) for name, values in compared.items()},
        }
        typer.echo(json.dumps(result, indent=2))
    elif not quiet:
        _print_tuning(tuning, best, compared, directory)


def _print_tuning(
    tuning: search.Tuning, best: search.Trial, compared: dict[str, tuple[float, ...]], directory: Path
) -> None:
    table = ui.table_of("", *(f">{name}" for name in tuning.objectives), title=f"{tuning.law} on the judging runs")
    for name, values in compared.items():
        table.add_row(name, *(f"{value:.4g}" for value in values))
    console = ui.PlainConsole()
    console.print(table)
    for name, value in best.parameters.items():
        console.print(f"{subject_of(tuning.tuned_on.scenario).parameters}.{name} = {value:.4g}")
    console.print(f"Run it: offtrack run {directory / 'tuned.toml'}", soft_wrap=True)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)
