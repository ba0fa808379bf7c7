"""A small world and its renderer, shared by the tests of this folder: both take seconds to make."""

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest

from sensors.camera.rig import StereoCalibration, StereoRig
from sensors.render import StereoRenderer
from sensors.world.world import World, build_world
from tests.trailers import truth as truth_at
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.surface import Surface

ROAD_HALF_WIDTH, CLEARANCE, RADIUS = 4.0, 8.0, 10.0  # [m]
SURFACE = Surface(friction=0.8, cross_fall=0.025, centre=(0.0, RADIUS))


def roundabout() -> FloatArray:
    """Along +x to the origin, once round to the left, and on along +x (n, 2) [m]: it meets itself at the origin."""
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = np.stack([RADIUS * np.sin(angle), RADIUS - RADIUS * np.cos(angle)], axis=1)
    return np.concatenate([[[-60.0, 0.0]], circle, [[60.0, 0.0]]])


def built(seed: int, *, scenery_density: float = 1.0, sun_elevation: float | None = None) -> World:
    return build_world(
        rng=np.random.default_rng(seed),
        centreline=roundabout(),
        road_half_width=ROAD_HALF_WIDTH,
        surface=SURFACE,
        scenery_density=scenery_density,
        clearance=CLEARANCE,
        sun_elevation=sun_elevation,
    )


@pytest.fixture(scope="session")
def truth_of() -> Callable[..., Truth]:
    """The truth of one unit at a tick, with what cameras look at and nothing else."""

    def truth(tick: int, X_WB: FloatArray, *, load_transfer: float = 0.0) -> Truth:
        return truth_at(tick, bodies=X_WB[None], load_transfer=np.array([load_transfer]))

    return truth


@pytest.fixture(scope="session")
def calibration() -> StereoCalibration:
    """The cameras of de Saxe & Cebon 2018, section 3.1, at the rear end of a trailer of 13.6 m."""
    rig = StereoRig(
        facing="rear", width=1344, height=391, hfov=math.radians(100.0), x=-13.6, y=0.0, z=3.0, baseline=0.5
    )
    return rig.calibration()


@pytest.fixture(scope="session")
def world() -> World:
    """Roundabout on a cone, with scenery."""
    return built(1)


@pytest.fixture
def built_in() -> Callable[..., World]:
    return partial(built, 1)


@pytest.fixture(scope="session")
def bare_world() -> World:
    """The same without scenery."""
    return built(1, scenery_density=0.0)


@pytest.fixture(scope="session")
def renderer(world: World, calibration: StereoCalibration) -> Iterator[StereoRenderer]:
    opened = StereoRenderer(world, calibration)
    yield opened
    opened.close()
