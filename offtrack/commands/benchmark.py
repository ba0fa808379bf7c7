"""`offtrack benchmark`: evaluate a law, a driver or a network in a task, beside the baselines."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from offtrack.commands import console as ui
from offtrack.environments.tasks import EPISODES, TASKS, task_of
from offtrack.environments.training import benchmark as evaluation
from vehicle.foundation.quantity import check_number

EXAMPLES = (
    "Examples: offtrack benchmark   offtrack benchmark roundabouts   "
    "offtrack benchmark roundabouts --policy path_preview   "
    "offtrack benchmark gate --policy model.zip --out results.json   offtrack benchmark gate --policy results.json"
)


def benchmark(
    task: Annotated[str | None, typer.Argument(help="Name of a task; none lists them.", show_default=False)] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Steering law, driver or network of the table, a network .npz, a model .zip of stable-baselines3, or "
            "the results .json of somebody else.",
            show_default="the table of the baselines",
        ),
    ] = None,
    observation: Annotated[
        str | None,
        typer.Option(help="Observation of the policy: surrogate, truth or estimate.", show_default="as in the task"),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Number of episodes; the benchmark's is the default.")] = EPISODES,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Results file; one with fewer episodes is continued.", show_default="runs/benchmark-TASK-POLICY.json"
        ),
    ] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Evaluate a policy in a task on the fixed seeds, and print it beside the baselines.

    The results file has the versions, the seeds and every episode. After an interrupt the same command continues.
    """
    check_number("--episodes", episodes, 1, 100_000)
    if task is None:
        if policy is not None:
            raise ValueError("--policy needs a task: offtrack benchmark TASK --policy …; offtrack benchmark lists them")
        _list(as_json=as_json)
        return
    task_of(task)
    rows = evaluation.shipped_results(task)
    evaluates = policy is not None and not policy.endswith(".json")
    if (out or observation) and not evaluates:
        raise ValueError("--out and --observation need a --policy that is to be evaluated")
    if policy is not None and not evaluates:
        rows.append(_of_task(evaluation.read_results(Path(policy)), task, policy))
    elif policy is not None:
        asked = evaluation.Evaluation(task, policy, observation)
        head = evaluation.header(asked)
        path = out or Path("runs") / f"benchmark-{task}-{head['policy'].replace(':', '.')}.json"
        former = _former(path, head)
        with ui.progress_display(shown=not (quiet or as_json)) as display:
            bar = ui.progress_bar(display, f"benchmark {task}")
            keep = partial(evaluation.write_results, path=path)
            rows.append(evaluation.evaluated(asked, head, episodes, bar, former=former, keep=keep))
    if as_json:
        typer.echo(json.dumps(plain_rows(rows), indent=2))
    elif not quiet:
        print_results(task, rows)
        if evaluates:
            ui.PlainConsole().print(f"Results: {path}", soft_wrap=True)


def _of_task(results: evaluation.Results, task: str, file: str) -> evaluation.Results:
    if results.head["task"] != task:
        raise ValueError(f"{file}: holds results of the task {results.head['task']}, not of {task}")
    if "vehicle" in results.head:
        raise ValueError(f"{file}: holds results of another vehicle, {results.head['vehicle']}")
    return results


def _former(path: Path, head: dict[str, Any]) -> evaluation.Results | None:
    """Results of the same evaluation in a file that exists."""
    if not path.exists():
        return None
    former = evaluation.read_results(path)
    differing = [key for key, value in head.items() if former.head[key] != value]
    if differing:
        raise ValueError(f"{path}: has results with another {differing[0]}: choose another --out, or delete it")
    ui.remark(f"{path}: continued after {len(former.episodes)} episodes")
    return former


def _list(*, as_json: bool) -> None:
    times = {name: [row.head["processor_s"] for row in evaluation.shipped_results(name)] for name in TASKS}
    listed = {
        name: {"role": task.role, "words": task.words, "drivers": task.drivers, "processor_s": times[name]}
        for name, task in TASKS.items()
    }
    columns = ("task", "role", "what is to be done", ">time [s]")
    table = ui.table_of(*columns, title=f"Tasks, and the time of {EPISODES} episodes", box=None, pad_edge=False)
    for name, task in TASKS.items():
        taken = f"{min(times[name]):.0f} to {max(times[name]):.0f}" if times[name] else "-"
        table.add_row(name, task.role, task.words, taken)
    ui.answer(listed, lambda: ui.PlainConsole().print(table), as_json=as_json)


def print_results(name: str, rows: list[evaluation.Results]) -> None:
    """Print the table of these results of a task."""
    task = task_of(name)
    title = f"{name}: means and 95 % intervals; error: {task.error} at the end; effort: RMS rate of the steering demand"
    columns = (">success\n[%]", ">error\n[m]", ">clearance\n[m]", ">effort\n[1/s]", ">rolled\nover [%]")
    table = ui.table_of("policy", *columns, title=title, pad_edge=False)  # fits 80 columns
    table.columns[0].overflow = "fold"
    for row in sorted(_rows(rows), key=lambda one: (-one["success"].mean, one["error_m"].mean)):
        other = "" if row["observation"] == task.observation else f"\n{row['observation']}"
        fewer = "" if row["episodes"] == EPISODES else f"\nepisodes: {row['episodes']}"
        table.add_row(
            row["policy"] + other + fewer + (f"\n{row['trainings']} trainings" if "trainings" in row else ""),
            _shown(row["success"], 100.0, 0),
            _shown(row["error_m"], 1.0, 3),
            "-" if row["clearance_m"] is None else _shown(row["clearance_m"], 1.0, 2),
            _shown(row["effort"], 1.0, 2),
            _shown(row["rolled_over"], 100.0, 0),
        )
    ui.PlainConsole().print(table)


def _shown(value: evaluation.Estimate, factor: float, digits: int) -> str:
    """Mean, and the interval below it."""
    mean, low, high = (f"{factor * number:.{digits}f}" for number in value)
    return f"{mean}\n{low}..{high}"


def plain_rows(results: list[evaluation.Results]) -> list[dict[str, Any]]:
    """The table of these results for JSON."""
    return [
        {name: value._asdict() if isinstance(value, evaluation.Estimate) else value for name, value in row.items()}
        for row in _rows(results)
    ]


def _rows(results: list[evaluation.Results]) -> list[dict[str, Any]]:
    """A row for each policy, then one for all trainings of a network."""
    summaries = [evaluation.summary(one) for one in results]
    return [*summaries, *evaluation.of_trainings(summaries)]
