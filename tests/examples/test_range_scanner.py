"""A sensor and an estimator from outside the packages: geometry of scans, motion between them, and a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from range_scanner import NOISE, RANGE, RangeScan, RangeScanner, row_camera
from scan_matching import ScanMatching, aligned

from estimators.estimates import Health
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_result import error_of_estimate
from sensors.faults.fault import Fault, with_faults
from sensors.faults.image_kinds import Dirt
from sensors.render import StereoRenderer
from sensors.world.scenery import Instances
from sensors.world.things import Part, Thing, box
from sensors.world.world import World, build_world
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform
from vehicle.surface import Surface

REAR, FOLLOW = -13.6, 11.0  # rear end and follow point of the trailer, from the hitch [m]
FOLDER = Path(__file__).parent / "range_scanner"
SETTINGS = ("sensor=range_scanner:RangeScanner", "off_tracking=scan_matching:ScanMatching")
PERIOD = 100  # between scans [ticks]


@pytest.fixture(scope="module")
def bare_world() -> World:
    line, surface = np.array([[-60.0, 0.0], [60.0, 0.0]]), Surface(friction=0.8)
    return build_world(
        rng=np.random.default_rng(1), centreline=line, road_half_width=4.0, surface=surface, scenery_density=0.0,
        clearance=8.0,
    )  # fmt: skip


def truth(k: int, pose: Pose2) -> Truth:
    none = np.empty(0)
    X_WB = transform(rotation_zyx(pose.psi, 0.0, 0.0), np.array([pose.x, pose.y, 0.0]))
    return Truth(
        tick=PERIOD * k, poses=np.array([pose]), velocities=np.zeros((1, 3)), bodies=X_WB[None], steer=none,
        wheel_loads=none, wheel_slip_angles=none, friction_used=none, load_transfer=np.zeros(1),
    )  # fmt: skip


def scanner(renderer: StereoRenderer, seed: int = 0) -> RangeScanner:
    return RangeScanner(renderer, unit=0, x=REAR, rng=np.random.default_rng(seed))


@pytest.mark.slow
def test_ranges_to_a_wall_are_those_of_its_geometry(bare_world: World) -> None:
    """A wall 15.4 m behind the scanner from 5 m on the left to 3 m on the right; around it there is nothing."""
    mesh = box((-30.0, -29.0), (-3.0, 5.0), (-1.0, 4.0), texture_size=1.0)
    wall = Thing(name="wall", parts=(Part(mesh=mesh, texture="stone"),), variety=0.0)
    stand = Instances(thing=wall, poses=np.eye(4)[None], brightness=np.ones(1))
    renderer = StereoRenderer(replace(bare_world, scenery=(stand,)), row_camera(REAR))
    scan = scanner(renderer).sample(truth(0, Pose2(0.0, 0.0, 0.0)))
    renderer.close()
    y = 15.4 * np.tan(np.pi - scan.bearings)  # where the beams cross the wall's plane [m]
    rearwards = np.cos(scan.bearings) < 0.0
    met = rearwards & (y > -3.0) & (y < 5.0)
    assert met.sum() == pytest.approx((math.atan2(3.0, 15.4) + math.atan2(5.0, 15.4)) / math.radians(0.25), abs=2)
    error = scan.ranges[met] + 15.4 / np.cos(scan.bearings[met])
    assert np.abs(error).max() < 5.0 * NOISE  # of some 120 beams
    assert np.abs(error.mean()) < 4.0 * NOISE / math.sqrt(met.sum())
    assert np.isinf(scan.ranges[~met]).all()


def test_nothing_in_range_is_lost_and_says_so() -> None:
    """On bare ground there is no motion to be had: infinite uncertainty, no value."""
    bearings = np.linspace(-2.0, 2.0, 100)
    scans = [RangeScan(tick=PERIOD * k, bearings=bearings, ranges=np.full(100, np.inf)) for k in range(3)]
    estimator = ScanMatching(REAR, FOLLOW)
    memory, first = estimator.step(estimator.init(), scans[0])
    assert first is None
    for scan in scans[1:]:
        memory, estimate = estimator.step(memory, scan)
        assert estimate is not None
        assert estimate.health is Health.LOST
        assert math.isinf(estimate.std)


def test_a_corridor_does_not_tell_the_way_along_it() -> None:
    """Two endless parallel walls: the scan is lost rather than matched at a place that the guess has chosen."""
    bearings = np.linspace(-2.8, 2.8, 400)
    ranges = 5.0 / np.maximum(np.abs(np.sin(bearings)), 1e-9)
    noise = NOISE * np.random.default_rng(0).standard_normal((2, 400))
    scans = [
        RangeScan(tick=k, bearings=bearings, ranges=np.where(ranges < RANGE, ranges + noise[k], np.inf))
        for k in range(2)
    ]
    assert aligned(scans[0], scans[1], Pose2(0.3, 0.0, 0.0)) is None


@pytest.mark.slow
def test_closed_loop_runs_by_settings_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Quarter of a roundabout, steered by the scans: import paths name both parts, nothing in the packages knows them.

    The hitch path is chained from some 28 motions of 1 to 4 cm (1 sigma) with partly correlated errors: a decimetre.
    """
    monkeypatch.chdir(FOLDER)
    result = run(load_scenario("roundabout", (*SETTINGS, "course.turn_deg=90")), 1)
    assert result.outcome == "completed"
    error, std = error_of_estimate(result), result.signal("off_tracking_std")
    valid = np.isfinite(error)
    assert valid.sum() > 200  # of some 250 scans; the first 14 m and a few with little scenery are lost
    assert np.sqrt(np.mean(error[valid] ** 2)) < 0.15  # [m]
    assert np.mean(std[valid]) < 0.3  # [m]
    assert np.abs(error[valid] / std[valid]).max() < 3.0


@pytest.mark.slow
def test_faults_of_transmission_apply_to_the_scanner(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its message is a dataclass with a tick: after 2 s no scan arrives any more."""
    monkeypatch.chdir(FOLDER)
    result = run(load_scenario("constant-slip", (*SETTINGS, "course.length=20", "faults=dropout:1@2+60")), 1)
    times = result.log["time"][np.isfinite(result.signal("health_semitrailer"))]
    assert times.max() == pytest.approx(1.9, abs=0.05)  # [s]


def test_faults_of_images_do_not_apply_to_the_scanner() -> None:
    class Nothing:
        def render_depth_from(self, X_WC1: FloatArray, X_WC2: FloatArray) -> tuple[FloatArray, FloatArray]:
            return np.full((1, 2048), np.inf), np.full((1, 2048), np.inf)

    scanner = RangeScanner(Nothing(), unit=0, x=REAR, rng=np.random.default_rng(0))
    fault = Fault(name="dirt", kind=Dirt)
    with pytest.raises(ValueError, match="faults: dirt needs a camera; the sensor of this run sends RangeScan"):
        with_faults(scanner, [fault], camera=None, unit=0, rng=np.random.default_rng)


def test_the_estimator_refuses_another_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)
    settings = ("sensor=reference_pose", "off_tracking=scan_matching:ScanMatching")
    with pytest.raises(ValueError, match="needs sensor = range_scanner:RangeScanner"):
        assemble(load_scenario("roundabout", settings), 1)
