"""Parts of the soak: each is something that a program does again and again, and must leave nothing behind."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.environments import registry
from scenarios.loop.runner import run
from scenarios.options.scenario import load_any_scenario
from sensors.render import StereoRenderer
from sensors.world.world import build_world
from tests.fuzz.files import settings
from tests.fuzz.specimens import RIG, SHORT, SHORT_ROVER, make
from vehicle.surface import Surface

Cycle = Callable[[], object]
_TURN: Final = (
    *("course.turn_deg=10", "course.entry=20", "course.exit=5", "speed_kmh=40", "rig.rate_hz=2"),
    *("rig.width=320", "rig.height=200", "world.scenery_density=0"),
)


class Part(NamedTuple):
    name: str
    opened: Callable[[Path], AbstractContextManager[Cycle]]  # context with the function that is one cycle
    cycles: int  # of a full soak
    megabytes: float = 0.3  # growth of memory that is allowed per cycle


@contextmanager
def _renderer(folder: Path) -> Iterator[Cycle]:
    line = np.stack([np.linspace(-40.0, 40.0, 41), np.zeros(41)], axis=1)
    world = build_world(
        rng=np.random.default_rng(1), centreline=line, road_half_width=4.0, surface=Surface(friction=0.8),
        scenery_density=0.1, clearance=8.0, sun_elevation=None,
    )  # fmt: skip

    def cycle() -> None:
        renderer = StereoRenderer(world, RIG.calibration())
        renderer.render(np.eye(4))
        renderer.close()

    yield cycle


@contextmanager
def _long_run(folder: Path) -> Iterator[Cycle]:
    environment = registry.vector("TrailerSteering-v0", 4)
    environment.reset(seed=1)
    straight = np.zeros_like(environment.action_space.sample())
    yield lambda: [environment.step(straight) for _ in range(500)]
    environment.close()


def _repeated(cycle: Cycle) -> Callable[[Path], AbstractContextManager[Cycle]]:
    """A cycle that needs no preparation."""

    @contextmanager
    def opened(folder: Path) -> Iterator[Cycle]:
        yield cycle

    return opened


def _environment(name: str, steps: int, *, many: int = 0, **options: Any) -> Callable[[Path], Any]:
    """Make, reset twice, step and close."""

    def cycle() -> None:
        made = registry.vector(name, many, **options) if many else registry.single(name, **options)
        made.action_space.seed(1)
        for seed in (1, 2):
            made.reset(seed=seed)
            for _ in range(steps):
                made.step(made.action_space.sample())
        made.close()

    return _repeated(cycle)


def _runs(scenario: str, *keys: str) -> Callable[[Path], Any]:
    """Runs in one process, as of a program that makes thousands."""

    def cycle() -> None:
        assert not run(load_any_scenario(scenario, list(keys)), 1).traceback

    return _repeated(cycle)


def _command(*arguments: str, specimen: str = "") -> Callable[[Path], Any]:
    """A command whose results are removed after each cycle."""

    @contextmanager
    def opened(folder: Path) -> Iterator[Cycle]:
        make(folder, filter(None, [specimen]))
        words = [word.replace("SPECIMEN", str(folder / specimen)) for word in arguments]

        def cycle() -> None:
            result = CliRunner().invoke(app, [*words, "--quiet", "--out", str(folder / "out")])
            assert result.exit_code == 0, result.output
            shutil.rmtree(folder / "out")

        yield cycle

    return opened


@contextmanager
def _refusals(folder: Path) -> Iterator[Cycle]:
    for name in ("bad.toml", "bad.csv", "bad.png", "bad.npz"):
        (folder / name).write_bytes(b"\x89PNG\x00[[[" * 200)
    file, short = f"{folder}/bad", settings(*SHORT)
    keys = ("driver.trace={}.csv", "surface.friction_image={}.png", "policy.path={}.npz")
    commands = [[word, f"{file}.toml"] for word in ("vehicle", "run", "sweep")]
    commands += [["run", "lane-change", *short, *settings(key.format(file))] for key in keys]
    commands[-1] += settings("trailer_steering=policy")

    def cycle() -> None:
        for command in commands:
            assert CliRunner().invoke(app, command).exit_code == 2

    yield cycle


_GRID: Final = ("--seeds", "1-2", "--controllers", "none", "--jobs", "2")
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
    Part("stereo recordings",
         _command("estimate", "off-tracking", "SPECIMEN/rectified", "--no-video", specimen="stereo"), 20, 0.6),
    Part("rover recordings", _command("estimate", "slip", "SPECIMEN/sand", "--no-video", specimen="rover"), 15, 0.6),
    Part("refusals", _refusals, 60),
)  # fmt: skip
