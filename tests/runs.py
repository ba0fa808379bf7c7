"""A run made up from kinematics: a tractor and a command-steered semitrailer on three quarters of a roundabout.

And the worlds of runs with cameras, each of which takes as long to build as some seconds of driving through it.
"""

import math
import pickle
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

import scenarios.assembly.trailer_sensors
from scenarios.results.log import Log, Signal
from scenarios.results.metrics import true_off_tracking
from scenarios.results.run_summary import Timing
from scenarios.results.swept_path import UnitOutline
from scenarios.results.trailer_result import CameraFrame, JudgedTrailer, RunResult
from sensors.world.world import World, build_world
from tests.browser import running_browser
from tests.in_process import make_runs_here
from vehicle.frames import FloatArray

STRAIGHT, RADIUS, TURN = 25.0, 11.0, 1.5 * math.pi  # [m], [m], [rad] of the tractor's rear axle
SPEED, STEP = 4.0, 0.01  # [m/s], [s]
FOLLOW, AXLE, HITCH_X = 11.9, 7.7, 0.6  # [m]
TRACTOR = UnitOutline("tractor", 5.2, -0.9, 2.5, (3.8, 0.0), (2.05, 1.85), ("steer_tractor", None))
STEERED = tuple(f"steer_trailer_{k}_trailer" for k in (1, 2, 3))
TRAILER = UnitOutline("trailer", 1.6, -12.0, 2.55, (-6.39, -7.7, -9.01), (2.05, 2.05, 2.05), STEERED)
WIDTH, HEIGHT = 1344, 392  # [px]


def drive() -> FloatArray:
    """Rows of x, y, psi of the tractor, x, y, psi of the trailer, steer of its axles (3), over time."""
    rows = []
    psi_S = 0.0
    for k in range(int((2 * STRAIGHT + RADIUS * TURN) / SPEED / STEP)):
        s = SPEED * STEP * k
        turned = min(max((s - STRAIGHT) / RADIUS, 0.0), TURN)
        x, y = STRAIGHT + RADIUS * math.sin(turned), RADIUS * (1.0 - math.cos(turned))
        beyond = min(s - STRAIGHT, 0.0) + max(s - STRAIGHT - RADIUS * TURN, 0.0)
        x, y = x + beyond * math.cos(turned), y + beyond * math.sin(turned)
        yaw_rate = SPEED / RADIUS if 0.0 < turned < TURN else 0.0
        x_S, y_S = x + HITCH_X * math.cos(turned), y + HITCH_X * math.sin(turned)
        slide = turned - psi_S + math.atan2(HITCH_X * yaw_rate, SPEED)  # direction of the hitch's travel in S
        steer = [-math.atan((a - 0.5 * FOLLOW) / (0.5 * FOLLOW) * math.tan(slide)) for a in (6.39, 7.7, 9.01)]
        rows.append([x, y, turned, x_S, y_S, psi_S, *steer])
        psi_S += STEP * math.hypot(SPEED, HITCH_X * yaw_rate) * math.sin(slide) / (0.5 * FOLLOW)
    return np.array(rows)


def picture(rng: np.random.Generator) -> bytes:
    """Rough ground below a bright sky, as JPEG."""
    grey = cv2.GaussianBlur(rng.normal(105.0, 60.0, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 1.5)
    grey[:196] = 215.0
    return cv2.imencode(".jpg", np.clip(grey, 0, 255).astype(np.uint8))[1].tobytes()


def camera_frames(rng: np.random.Generator, ticks: FloatArray) -> tuple[CameraFrame, ...]:
    """Frames with features flowing towards the horizon, as they do behind a vehicle that drives on."""
    jpeg, frames = picture(rng), []
    for tick in ticks.astype(int).tolist():
        n = int(rng.integers(280, 360))
        u, v = rng.uniform(20, WIDTH - 20, n), rng.uniform(205, HEIGHT - 10, n)
        closer = 1.0 - 0.4 / (3.0 * 564.0 / (v - 195.0))
        tracks = np.column_stack([u, v, 671.5 + (u - 671.5) * closer + 4.0, 195.0 + (v - 195.0) * closer])
        frames.append(CameraFrame(tick=tick, jpeg=jpeg, tracks=tracks.astype(np.float32), matches=n + 40, inliers=n))
    return tuple(frames)


def make_run(*, cameras: bool) -> RunResult:
    """The synthetic run, with an estimate and camera frames at 10 Hz or with neither."""
    rng, path = np.random.default_rng(7), drive()
    n = len(path)
    ticks = 10.0 * np.arange(n, dtype=np.float64)
    true = true_off_tracking(path[:, 3], path[:, 4], path[:, 5], FOLLOW)
    columns = {("tick", "-"): ticks, ("time", "s"): 1e-3 * ticks, ("v_x_tractor", "m/s"): np.full(n, SPEED)}
    places = [(f"{name}_{unit}", kind) for unit in ("tractor", "trailer")
              for name, kind in (("x", "m"), ("y", "m"), ("psi", "rad"))]  # fmt: skip
    columns |= dict(zip(places, path.T[:6], strict=True))
    columns["steer_tractor", "rad"] = np.gradient(path[:, 2], STEP) * 3.8 / SPEED
    columns["off_tracking_true", "m"] = true
    for k in range(3):
        columns[f"steer_trailer_{k + 1}", "rad"] = np.roll(path[:, 6 + k], 15)
        columns[f"steer_trailer_{k + 1}_command", "rad"] = path[:, 6 + k]
    if cameras:
        columns |= estimates(rng, path, true)
    of_unit = ("tick", "time", "x_", "y_", "psi_", "v_x_", "steer_tractor")
    columns |= {(f"{name}_trailer", unit): v for (name, unit), v in columns.items() if not name.startswith(of_unit)}
    signals = tuple(Signal(name, unit, f"{name} of the run") for name, unit in columns)
    return RunResult(
        scenario="roundabout",
        scenario_toml='trailer_steering = "command_steer"\nspeed_kmh = 14.4\n\n[surface]\nfriction = 0.8  # <dry>\n',
        seed=7,
        outcome="completed",
        log=Log(signals, np.column_stack(list(columns.values()))),
        units=(TRACTOR, TRAILER),
        trailers=(JudgedTrailer(name="trailer", follow_distance=FOLLOW, n_steered=3, max_steer=math.radians(30.0)),),
        road=path[::25, :2],
        road_half_width=3.5,
        circle_centre=(STRAIGHT, RADIUS),
        timing=Timing(simulated_s=n * STEP, wall_s=41.0, physics_s=6.2, render_s=21.4, odometry_s=9.1),
        frames=camera_frames(rng, ticks[10::10]) if cameras else (),
        manifest={"opengl_renderer": "none: synthetic", "frames_sha256": "0" * 64} if cameras else {},
    )


def estimates(rng: np.random.Generator, path: FloatArray, true: FloatArray) -> dict[tuple[str, str], FloatArray]:
    """Columns of an estimator with 8 mm of noise and an odometry that is 1 % short, lost in one frame at 9 s."""
    n = len(path)
    captures = np.arange(10, n, 10)
    z, psi = path[:, 3] + 1j * path[:, 4], path[:, 5]
    motion = (z[captures] - z[captures - 10]) * np.exp(-1j * psi[captures - 10])
    noise = np.convolve(rng.normal(0.0, 0.011, len(captures)), np.full(4, 0.5), mode="same")  # the buffer smooths
    lost = np.isnan(true[captures])
    values = {
        ("off_tracking_estimate", "m"): np.where(lost, 0.0, true[captures] + noise),
        ("off_tracking_std", "m"): np.where(lost, np.inf, 0.012),
        ("matches", "-"): rng.integers(320, 400, len(captures)).astype(float),
        ("inliers", "-"): rng.integers(280, 320, len(captures)).astype(float),
        ("health", "-"): np.where(lost, 2.0, 0.0),
        ("odometry_health", "-"): np.where(captures == 900, 2.0, 0.0),
        ("odometry_dx", "m"): 0.99 * motion.real,
        ("odometry_dy", "m"): 0.99 * motion.imag,
        ("odometry_dpsi", "rad"): psi[captures] - psi[captures - 10],
    }
    columns = {}
    for key, value in values.items():
        columns[key] = np.full(n, np.nan)
        columns[key][captures] = value
    return columns


@pytest.fixture(scope="session")
def camera_run() -> RunResult:
    """A run with a stereo camera and an estimate."""
    return make_run(cameras=True)


@pytest.fixture(scope="session")
def blind_run() -> RunResult:
    """A run without cameras."""
    return make_run(cameras=False)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, without a window."""
    with running_browser() as started:
        yield started


@pytest.fixture
def runs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the runs of studies in this process."""
    make_runs_here(monkeypatch)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of pages are put together but not drawn, which takes half of a page's time: for tests of other things."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda self, file, **_: file.write("<svg></svg>"))


class Worlds:
    """Builds each world once: of the same arguments and generator comes the same one (tests/sensors/test_world.py)."""

    KEPT = 6  # some 50 MB each

    def __init__(self) -> None:
        self._built: dict[bytes, tuple[World, Any]] = {}

    def build(self, *, rng: np.random.Generator, **arguments: Any) -> World:
        """As ``build_world``; the generator then is where building the world would have left it."""
        key = pickle.dumps((rng.bit_generator.state, arguments))
        if key not in self._built:
            if len(self._built) == self.KEPT:
                self._built.pop(next(iter(self._built)))
            self._built[key] = build_world(rng=rng, **arguments), rng.bit_generator.state
        world, rng.bit_generator.state = self._built[key]
        return world

    def forget(self) -> None:
        """The next ones are built anew."""
        self._built.clear()


@pytest.fixture(scope="session")
def kept_worlds() -> Worlds:
    """The worlds of all tests of a process."""
    return Worlds()


@pytest.fixture(scope="module")
def worlds(kept_worlds: Worlds) -> Iterator[Worlds]:
    """Build each world once, for modules that ask for it: elsewhere every run builds its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenarios.assembly.trailer_sensors, "build_world", kept_worlds.build)
        yield kept_worlds
