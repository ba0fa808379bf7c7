"""Where a rover is beside its path, and its trace in the image, against closed forms."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controllers.path import Path, arc
from scenarios.results.log import Log, Signal
from scenarios.results.rover_result import path_coordinates, soil_warnings, trace_line
from sensors.sand.trace_rig import nominal_rig
from vehicle.frames import Pose2
from vehicle.rover.description import load_rover


def test_a_rover_beside_its_path_has_a_station_and_an_offset() -> None:
    """0.3 m inside a quarter circle of 2 m radius to the left, a third of the way round."""
    along = math.radians(30.0)
    truth: Any = SimpleNamespace(pose=np.array([1.7 * math.sin(along), 2.0 - 1.7 * math.cos(along), 0.0]))
    path = Path(Pose2(0.0, 0.0, 0.0), (arc(math.pi, 0.5),))
    assert path_coordinates(path, truth, 0.9) == pytest.approx((2.0 * along, 0.3), abs=1e-9)


@pytest.mark.parametrize(("direction", "offset"), [(0.0, 0.03), (0.2, 0.0), (-0.1, -0.02)])
def test_a_trace_lies_behind_its_wheel_in_the_direction_of_travel(direction: float, offset: float) -> None:
    """Its pixels, taken back to the ground: a line that meets the wheel's axis at the offset."""
    rig = nominal_rig(load_rover("el_dorado_ii"))
    pixels = trace_line(rig, direction, offset)
    x, y, scale = np.linalg.inv(rig.image_of_ground()) @ np.column_stack([pixels, np.ones(len(pixels))]).T
    behind = rig.wheel[0] - x / scale
    assert (behind > 0.0).all()
    np.testing.assert_allclose(y / scale, rig.wheel[1] + offset - behind * math.tan(direction), atol=2e-3)  # the lens


@pytest.mark.parametrize(("angle_deg", "seconds", "warns"), [(40.0, 3.0, 0), (50.0, 0.4, 0), (-50.0, 0.6, 1)])
def test_travel_across_a_wheel_beyond_the_measured_range_is_a_warning(
    angle_deg: float, seconds: float, warns: int
) -> None:
    """At a standstill, where a direction means nothing, it is none."""
    time = 0.02 * np.arange(200)
    speed = np.where(time < 3.0, 0.08, 0.0)
    slip = np.where(time < seconds, math.radians(angle_deg), 0.0)
    slip[-20:] = 1.5
    columns = {"time": time, "v_x": speed, "v_y": 0.0 * time, "wheel_slip_true": slip}
    log = Log.of([(Signal(name, "", ""), values) for name, values in columns.items()])
    lines = list(soil_warnings(log))
    assert len(lines) == warns
    assert all(f"for {seconds:.1f} s, from 0.0 s on" in line and "at most 50°" in line for line in lines)
