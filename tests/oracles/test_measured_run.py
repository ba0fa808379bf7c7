"""A run on a measured surface against one on the random roughness that the surface was sampled from.

Differences remain: the file's heights are averaged by the tyre twice, and its waves longer than 50 m are slope and bank
of the ground.
"""

from pathlib import Path

import numpy as np
import pyopencrg
import pytest

from scenarios.assembly.adapters import course_of, surface_of, vehicle_of
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario, stream
from vehicle.frames import dense
from vehicle.surface.relief import BesideLine

_BASE = ("off_tracking=truth", "trailer_steering=none", "speed_kmh=60")
_BEFORE = 30.0  # the file begins before the guided point's start [m]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_sampled_roughness_shakes_as_the_roughness_itself(tmp_path: Path, seed: int) -> None:
    """Roll and pitch by the surface alone: of the same size within 6 %, and correlated by more than 0.98."""
    rough = load_scenario("lane-change", (*_BASE, "surface.roughness=C"))
    course = course_of(rough, vehicle_of(rough))
    profile = surface_of(rough, course, stream(seed, "surface")).roughness
    assert profile is not None
    assert profile.profile is not None
    line, _ = dense(course.centreline, 0.25)
    beside = BesideLine(line)
    start = beside.at(*course.path.start[:2]).along - _BEFORE
    u, v = np.arange(0.0, course.length + _BEFORE + 25.0, 0.05), np.arange(-4.0, 4.001, 0.05)
    x, y = beside.place(start + np.repeat(u, len(v)), np.tile(v, len(u))).T
    heights = profile.profile.height(x, y).reshape(len(u), len(v))
    pyopencrg.CrgRoad(heights, u_inc=0.05, v=v).save(tmp_path / "rough.crg", fmt="KRBI")
    file = (f"surface.crg={tmp_path / 'rough.crg'}", f"surface.crg_start={-_BEFORE}")
    logs = [
        run(load_scenario("lane-change", (*_BASE, *more)), seed).log for more in (("surface.roughness=C",), file, ())
    ]
    count = min(len(log["time"]) for log in logs)
    for motion in ("roll_tractor", "roll_semitrailer", "pitch_tractor", "pitch_semitrailer"):
        random, measured, level = (log[motion][:count] for log in logs)
        first, second = random - level, measured - level
        assert second.std() == pytest.approx(first.std(), rel=0.06), motion
        assert np.corrcoef(first, second)[0, 1] > 0.98, motion
