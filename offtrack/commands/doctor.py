"""`offtrack doctor`: what this machine can do."""

import math
import os
import platform
import re
import time
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from typing import Annotated

import numpy as np
import typer

from offtrack.commands.console import PlainConsole, listing, table_of
from scenarios.extras import installation
from scenarios.processes import default_jobs
from sensors.camera.rig import StereoCalibration, StereoRig
from sensors.render import DEVICE_VARIABLE, RendererUnavailableError, StereoRenderer, check_renderer, device_names
from sensors.world.world import World, build_world
from vehicle.engine.compiler import compiler, engine_name
from vehicle.surface import Surface

EXAMPLES = "Examples: offtrack doctor   offtrack doctor --render   OFFTRACK_EGL_DEVICE=1 offtrack run roundabout"
_PAIRS = 30  # after the first ones, which take longer


def doctor(
    render: Annotated[bool, typer.Option("--render", help="List EGL's devices and time stereo pairs on each.")] = False,
) -> None:
    """Say what this machine can do, what is missing, and the command that mends it.

    --render lists the devices that can render the cameras, with their times for a stereo pair of 1344x391 px.
    """
    if not render:
        PlainConsole().print(listing(_checks()))
        return
    surface, line = Surface(friction=0.8), np.array([[-60.0, 0.0], [60.0, 0.0]])
    rng = np.random.default_rng(1)
    world = build_world(
        rng=rng, centreline=line, road_half_width=4.0, surface=surface, scenery_density=1, clearance=8.0
    )
    rig = StereoRig(facing="rear", width=1344, height=391, hfov=math.radians(100.0), x=0.0, y=0.0, z=3.0, baseline=0.5)
    table = table_of("device", "file", "renderer", "pair [ms]", "processor [ms]")
    usual = os.environ.get(DEVICE_VARIABLE, "")
    for number, name in enumerate(device_names()):
        os.environ[DEVICE_VARIABLE] = str(number)
        try:
            table.add_row(str(number), name, *_timed(world, rig.calibration()))
        except RendererUnavailableError as error:
            table.add_row(str(number), name, str(error), "", "")
    PlainConsole().print(table)
    os.environ[DEVICE_VARIABLE] = usual
    typer.echo(f"Runs render on {check_renderer()}.")
    typer.echo(f"{DEVICE_VARIABLE}=NUMBER (or FILE) chooses another device.")


def _checks() -> Iterator[tuple[str, str]]:
    """Name and finding of each check, the most important first."""
    yield "offtrack", f"{version('offtrack')}, Python {platform.python_version()}"
    try:
        yield "cameras", f"rendered by {check_renderer()}"
    except (RendererUnavailableError, ValueError) as error:
        mends = (
            "sudo apt-get install libegl1 libgl1 libgl1-mesa-dri; without OpenGL, set off_tracking to another source"
        )
        yield "cameras", f"not available: {error}. {mends}"
    mends = "" if compiler() else ". Five times as slow: sudo apt-get install gcc"
    yield "vehicle models", f"{engine_name()}{mends}"
    yield "cores", f"{default_jobs()}: as many runs of a study at a time"
    for extra, packages in _extras().items():
        missing = [package for package in packages if not _is_installed(package)]
        yield f"extra {extra}", f"missing: {', '.join(missing)}. {installation(extra)}" if missing else "installed"


def _extras() -> dict[str, list[str]]:
    """Packages of each extra that users need, as the installed offtrack names them."""
    extras: dict[str, list[str]] = {}
    for line in requires("offtrack") or ():
        found = re.match(r"""([\w.-]+).*extra == ['"](\w+)['"]""", line)
        if found and found[2] not in ("dev", "docs", "oracles"):
            extras.setdefault(found[2], []).append(found[1])
    return extras


def _is_installed(package: str) -> bool:
    try:
        return bool(version(package))
    except PackageNotFoundError:
        return False


def _timed(world: World, calibration: StereoCalibration) -> tuple[str, ...]:
    """Renderer's name, and time and processor time of a pair [ms]."""
    renderer, X_WB = StereoRenderer(world, calibration), np.eye(4)
    for pair in range(_PAIRS + 5):
        if pair == 5:
            start, used = time.perf_counter(), time.process_time()
        X_WB[0, 3] = 0.3 * pair
        renderer.render(X_WB)
    times = (time.perf_counter() - start, time.process_time() - used)
    renderer.close()
    return renderer.name.split(", OpenGL")[0], *(f"{1e3 * t / _PAIRS:.1f}" for t in times)
