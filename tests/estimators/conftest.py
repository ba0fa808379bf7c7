"""The stereo drive that all tests of odometries share; it takes seconds to draw."""

from typing import Any

import numpy as np
import pytest

from estimators.context import Odometry
from scenarios.catalogue import ODOMETRY, resolve
from sensors.camera.rig import StereoCalibration, StereoRig
from tests.estimators.stereo_scene import Drive, stereo_drive
from vehicle.engine import compiler as compiler_module
from vehicle.engine.compiler import compiler


@pytest.fixture(scope="session")
def calibration() -> StereoCalibration:
    """The cameras of de Saxe 2018, section 3.1, on the rear of a 14 m trailer."""
    return StereoRig(
        facing="rear", width=1344, height=391, hfov=np.radians(100.0), x=-14.0, y=0.0, z=3.0, baseline=0.5
    ).calibration()


@pytest.fixture(scope="session")
def drive(calibration: StereoCalibration) -> Drive:
    """46 frames at 10 Hz."""
    return stereo_drive(calibration)


@pytest.fixture(params=sorted(ODOMETRY))
def name(request: pytest.FixtureRequest) -> str:
    """Every odometry of the catalogue in turn."""
    chosen: str = request.param
    return chosen


@pytest.fixture
def odometry(name: str, drive: Drive) -> Odometry[Any]:
    """It, for the cameras of the drive."""
    part: Odometry[Any] = resolve("odometry", name, ODOMETRY)(drive.calibration)
    return part


@pytest.fixture(params=["compiled", "without a compiler"])
def back_end(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernels of the odometries in C, and what takes their place without a compiler."""
    if request.param == "without a compiler":
        monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    elif compiler() is None:
        pytest.skip("there is no compiler")
    else:
        compiler_module._kernel.cache_clear()
        monkeypatch.setattr(compiler_module, "warn_once", pytest.fail)  # a kernel that is not compiled
