"""Files of a training directory other than checkpoint and curve: plan, network, picture, summary."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

from controllers.trailer_steering.policy import Network, save_network
from scenarios.results.files import replaced, replacing
from scenarios.studies.files import check_study_directory, opened_study
from scenarios.training.curve import Point, draw_curve
from scenarios.training.evaluation import POLICY, Score, described
from scenarios.training.plan import Plan
from vehicle.user_file import FileKind, read_text

PLAN: Final = "training.json"
NETWORK: Final = "policy.npz"
SUMMARY: Final = "summary.json"
PICTURE: Final = "learning_curve.png"
_PACKAGES: Final = ("offtrack", "stable-baselines3", "torch", "gymnasium", "numpy", "casadi")

Scores = Mapping[str, Mapping[str, Score]]  # by condition and law


def check_directory(plan: Plan, directory: Path) -> None:
    """Refuse a directory that contains another training or other files.

    Raises:
        ValueError: one line.
    """
    check_study_directory(directory, PLAN)
    file = directory / PLAN
    if file.is_file() and read_text(file, FileKind.RECORD) != _content(plan):
        raise ValueError(
            f"{file} belongs to a training with other options: choose another --out, or use the same options"
        )


def opened_directory(plan: Plan, directory: Path) -> AbstractContextManager[None]:
    """Lock the directory of a training, which has been checked, and write its plan.

    Raises:
        ValueError: one line, if another process works in it.
    """
    return opened_study(directory, PLAN, _content(plan))


def _content(plan: Plan) -> str:
    return json.dumps(plan.plain(), indent=2) + "\n"


def keep_network(network: Network, directory: Path) -> Path:
    """Write the network completely or not at all, and return its file."""
    path = directory / NETWORK
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        save_network(network, file)
    return path


def summary(plan: Plan, curve: list[Point], scores: Scores, command: str) -> dict[str, Any]:
    """Summary of the training for JSON."""
    last = curve[-1]
    return {
        "command": command,
        "plan": plan.plain(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "steps": last.steps,
        "wall_s": round(last.wall_s, 1),
        "conditions": described(),
        "scores": {name: {law: score._asdict() for law, score in laws.items()} for name, laws in scores.items()},
    }


def keep_summary(content: Mapping[str, Any], curve: list[Point], scores: Scores, directory: Path) -> None:
    """Write ``summary.json`` and the learning curve, with the laws' results in the training conditions."""
    replaced(directory / SUMMARY, json.dumps(content, indent=2, allow_nan=False) + "\n")
    levels = {law: score.rms_m for law, score in scores["trained"].items() if law != POLICY}
    draw_curve(curve, levels, directory / PICTURE)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
