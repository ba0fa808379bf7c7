"""Parts of the soak: each is something that a program does again and again, and must leave nothing behind."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from tests.fuzz.files import settings
from tests.fuzz.specimens import RIG, SHORT, SHORT_ROVER, make

Cycle = Callable[[], object]
_TURN: Final = (
    *("course.turn_deg=10", "course.entry=20", "course.exit=5", "speed_kmh=40", "rig.rate_hz=2"),
    *("rig.width=320", "rig.height=200", "world.scenery_density=0"),
)


class Part(NamedTuple):
    name: str
    opened: Callable[[Path], Any]  # context with the function that is one cycle
    cycles: int  # of a full soak
    megabytes: float = 0.3  # growth of memory that is allowed per cycle


@contextmanager
def _renderer(folder: Path) -> Iterator[Cycle]:
    from sensors.render import StereoRenderer
    from sensors.world.world import build_world
    from vehicle.surface import Surface

    line = np.stack([np.linspace(-40.0, 40.0, 41), np.zeros(41)], axis=1)
    world = build_world(
        rng=np.random.default_rng(1), centreline=line, road_half_width=4.0, surface=Surface(friction=0.8),
        scenery_density=0.1, clearance=8.0, sun_elevation=None,
    )  # fmt: skip
    pose = np.eye(4)

    def cycle() -> None:
        renderer = StereoRenderer(world, RIG.calibration())
        renderer.render(pose)
        renderer.close()

    yield cycle


def _environment(name: str, steps: int, *, many: int = 0, **options: Any) -> Callable[[Path], Any]:
    """Make, reset twice, step and close."""

    @contextmanager
    def opened(folder: Path) -> Iterator[Cycle]:
        from offtrack.environments import registry

        def cycle() -> None:
            made = registry.vector(name, many, **options) if many else registry.single(name, **options)
            made.action_space.seed(1)
            for seed in (1, 2):
                made.reset(seed=seed)
                for _ in range(steps):
                    made.step(made.action_space.sample())
            made.close()

        yield cycle

    return opened


@contextmanager
def _long_run(folder: Path) -> Iterator[Cycle]:
    from offtrack.environments import registry

    environment = registry.vector("TrailerSteering-v0", 4)
    environment.reset(seed=1)
    straight = np.zeros_like(environment.action_space.sample())

    def cycle() -> None:
        for _ in range(500):
            environment.step(straight)

    yield cycle
    environment.close()


def _command(*arguments: str) -> Callable[[Path], Any]:
    """A command whose results are removed after each cycle."""

    @contextmanager
    def opened(folder: Path) -> Iterator[Cycle]:
        from typer.testing import CliRunner

        from offtrack.commands.cli import app

        specimen = _SPECIMENS.get(arguments[2].rpartition("/")[2], "")
        if specimen:
            make(folder, [specimen])
        words = [word.replace("SPECIMEN", str(folder / specimen)) for word in arguments]

        def cycle() -> None:
            result = CliRunner().invoke(app, [*words, "--quiet", "--out", str(folder / "out")])
            assert result.exit_code == 0, result.output
            shutil.rmtree(folder / "out")

        yield cycle

    return opened


def _runs(scenario: str, *keys: str) -> Callable[[Path], Any]:
    """Runs in one process, as of a program that makes thousands."""

    @contextmanager
    def opened(folder: Path) -> Iterator[Cycle]:
        from scenarios.loop.runner import run
        from scenarios.options.scenario import load_any_scenario

        def cycle() -> None:
            assert not run(load_any_scenario(scenario, list(keys)), 1).traceback

        yield cycle

    return opened


@contextmanager
def _refusals(folder: Path) -> Iterator[Cycle]:
    from typer.testing import CliRunner

    from offtrack.commands.cli import app

    for name in ("bad.toml", "bad.csv", "bad.png", "bad.npz"):
        (folder / name).write_bytes(b"\x89PNG\x00[[[" * 200)
    commands = (
        ["vehicle", "bad.toml"],
        ["run", "bad.toml"],
        ["sweep", "bad.toml"],
        ["run", "lane-change", *settings(*SHORT, "driver.trace=bad.csv")],
        ["run", "lane-change", *settings(*SHORT, "surface.friction_image=bad.png")],
        ["run", "lane-change", *settings(*SHORT, "trailer_steering=policy", "policy.path=bad.npz")],
    )

    def cycle() -> None:
        for command in commands:
            words = [
                str(folder / word) if word.startswith("bad") else word.replace("=bad", f"={folder}/bad")
                for word in command
            ]
            assert CliRunner().invoke(app, words).exit_code == 2

    yield cycle


_GRID: Final = ("--seeds", "1-2", "--controllers", "none", "--jobs", "2")
_SPECIMENS: Final = {"rectified": "stereo", "sand": "rover"}
PARTS: Final = (
    Part("renderer", _renderer, 40),
    Part("trailer environment", _environment("TrailerSteering-v0", 50), 60),
    Part("driving environment", _environment("TractorTrailerDriving-v0", 50), 60),
    Part("rover environment", _environment("RoverSteering-v0", 20), 40),
    Part("vector environment", _environment("TrailerSteering-v0", 20, many=32), 40),
    Part("trailer with cameras", _environment("TrailerSteering-v0", 6, observation="camera", image_scale=8), 8, 3.0),
    Part("rover with a camera", _environment("RoverSteering-v0", 4, observation="camera"), 15, 1.0),
    Part("long run", _long_run, 40),
    Part("runs in one process", _runs("lane-change", *SHORT), 1000, 0.02),
    Part("runs with cameras in one process", _runs("turn-90", *_TURN, "off_tracking=viso_ot"), 100, 0.2),
    Part("trailer runs and reports", _command("run", "lane-change", *settings(*SHORT), "--no-video"), 20, 0.6),
    Part("rover runs, reports and videos", _command("run", "rover-slope", *settings(*SHORT_ROVER)), 10, 1.0),
    Part("vehicle sheets", _command("vehicle", "uk_longer_semitrailer"), 20, 0.6),
    Part("sweeps with workers", _command("compare", "lane-change", *settings(*SHORT), *_GRID), 6, 1.0),
    Part("stereo recordings", _command("estimate", "off-tracking", "SPECIMEN/rectified", "--no-video"), 20, 0.6),
    Part("rover recordings", _command("estimate", "slip", "SPECIMEN/sand", "--no-video"), 15, 0.6),
    Part("refusals", _refusals, 60),
)
