"""A sensor and an estimator from outside the packages: geometry of scans, motion between them, and a run."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from range_scanner import NOISE, RANGE, RangeScan, RangeScanner, row_camera
from scan_matching import ScanMatching, aligned

from estimators.estimates import Health, OffTracking
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
RADIUS = 25.0  # of the bend [m]
FOLDER = Path(__file__).parent / "range_scanner"
SETTINGS = ("sensor=range_scanner:RangeScanner", "off_tracking=scan_matching:ScanMatching")
PERIOD, STEP = 100, 0.5  # between scans [ticks], [m]: 5 m/s


def bend() -> FloatArray:
    """Along +x to the origin, a quarter turn to the left, and on along +y (n, 2) [m]."""
    angle = np.linspace(0.0, 0.5 * np.pi, 200)
    arc = np.stack([RADIUS * np.sin(angle), RADIUS - RADIUS * np.cos(angle)], axis=1)
    return np.concatenate([[[-60.0, 0.0]], arc, [[RADIUS, RADIUS + 60.0]]])


def built(scenery_density: float) -> World:
    return build_world(
        rng=np.random.default_rng(1),
        centreline=bend(),
        road_half_width=4.0,
        surface=Surface(friction=0.8, cross_fall=0.0, centre=(0.0, RADIUS)),
        scenery_density=scenery_density,
        clearance=8.0,
    )


@pytest.fixture(scope="module")
def bare_world() -> World:
    return built(0.0)


@pytest.fixture(scope="module")
def scans() -> list[RangeScan]:
    """Scans of the drive past scenery."""
    renderer = StereoRenderer(built(1.0), row_camera(REAR))
    source = scanner(renderer)
    sampled = [source.sample(truth(k, pose)) for k, pose in enumerate(drive())]
    renderer.close()
    return sampled


def truth(k: int, pose: Pose2) -> Truth:
    """Truth of a single level unit at capture ``k``."""
    none = np.empty(0)
    X_WB = transform(rotation_zyx(pose.psi, 0.0, 0.0), np.array([pose.x, pose.y, 0.0]))
    return Truth(
        tick=PERIOD * k,
        poses=np.array([pose]),
        velocities=np.zeros((1, 3)),
        bodies=X_WB[None],
        steer=none,
        wheel_loads=none,
        wheel_slip_angles=none,
        friction_used=none,
        load_transfer=np.zeros(1),
    )


def drive() -> list[Pose2]:
    """30 m straight on and 40 m through the bend: poses of the trailer, one step apart."""
    poses = [Pose2(-30.0, 0.0, 0.0)]
    for k in range(140):
        curvature = 0.0 if k < 60 else 1.0 / RADIUS
        poses.append(poses[-1] @ Pose2(STEP, 0.5 * STEP**2 * curvature, STEP * curvature))
    return poses


def between(first: Pose2, second: Pose2) -> FloatArray:
    """Pose (3,) of the second in the first."""
    c, s = math.cos(first.psi), math.sin(first.psi)
    x, y = second.x - first.x, second.y - first.y
    return np.array([c * x + s * y, c * y - s * x, second.psi - first.psi])


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


def test_beams_cover_the_rear_evenly(bare_world: World) -> None:
    """240 deg around the rear, neighbours a quarter of a degree apart, to a pixel."""
    renderer = StereoRenderer(bare_world, row_camera(REAR))
    bearings = np.sort(np.mod(scanner(renderer).sample(truth(0, Pose2(0.0, 0.0, 0.0))).bearings, 2.0 * np.pi))
    renderer.close()
    assert np.degrees(bearings[[0, -1]]) == pytest.approx([60.0, 300.0], abs=0.3)
    assert np.degrees(np.diff(bearings)) == pytest.approx(np.full(len(bearings) - 1, 0.25), abs=0.1)


@pytest.mark.slow
def test_motion_past_scenery_is_found_within_its_uncertainty(scans: list[RangeScan]) -> None:
    """Every step of a drive at 5 m/s; errors of the scanner's motion against the prescribed one.

    Range noise of 2 cm over some 300 points leaves a few millimetres. Foliage is no line: it adds as much again.
    """
    poses, guess, errors, normalised = drive(), Pose2(0.0, 0.0, 0.0), [], []
    for k in range(1, len(poses)):
        match = aligned(scans[k - 1], scans[k], guess)
        if match is None:
            continue
        mount = Pose2(REAR, 0.0, 0.0)
        error = np.array(match.pose) - between(poses[k - 1] @ mount, poses[k] @ mount)
        errors.append(error)
        normalised.append(float(error @ np.linalg.solve(match.covariance, error)))
        guess = match.pose
    assert len(errors) >= 0.95 * (len(poses) - 1)  # little scenery at the start: a scan or two is lost
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms[:2] < 0.012).all()  # [m]
    assert rms[2] < math.radians(0.04)
    # Squared errors over their variance are 3 in the mean if the covariance is exact. It is to be safe, but not idle.
    assert 0.2 < np.mean(normalised) < 3.0
    assert max(normalised) < 16.3  # 99.9 % of chi-square with 3 degrees of freedom


def test_off_tracking_of_a_drive_is_within_its_uncertainty(scans: list[RangeScan]) -> None:
    """The hitch drives straight and then on an arc; the follow point cuts in by what geometry says."""
    poses, estimator = drive(), ScanMatching(REAR, FOLLOW)
    memory, estimates = estimator.init(), list[OffTracking]()
    for scan in scans:
        memory, estimate = estimator.step(memory, scan)
        if estimate is not None:
            estimates.append(estimate)
    healthy = [estimate for estimate in estimates if estimate.health is Health.OK and estimate.tick > 3000]
    assert len(healthy) > 0.8 * (len(poses) - 31)
    errors, stds = [], []
    for estimate in healthy:
        pose = poses[estimate.tick // PERIOD]
        past = np.array([between(pose, before)[:2] for before in poses[: estimate.tick // PERIOD + 1]])  # in S
        expected = float(np.interp(-FOLLOW, past[:, 0], past[:, 1]))
        errors.append(estimate.value - expected)
        stds.append(estimate.std)
    normalised = np.abs(errors) / np.array(stds)
    assert np.sqrt(np.mean(np.square(errors))) < 0.06  # [m] its own standard deviation is 5 cm in the mean
    assert np.mean(stds) < 0.1  # [m]
    assert normalised.max() < 3.0


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
    """It has a window that can get dirty, but its message holds no image."""

    class Nothing:
        def render_depth_from(self, X_WC1: FloatArray, X_WC2: FloatArray) -> tuple[FloatArray, FloatArray]:
            return np.full((1, 2048), np.inf), np.full((1, 2048), np.inf)

    scanner = RangeScanner(Nothing(), unit=0, x=REAR, rng=np.random.default_rng(0))
    fault = Fault(name="dirt", kind=Dirt)
    with pytest.raises(ValueError, match="faults: dirt needs a camera; the sensor of this run sends RangeScan"):
        with_faults(scanner, [fault], camera=None, unit=0, rng=np.random.default_rng)


def test_the_estimator_refuses_another_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """One line names the sensor it needs."""
    monkeypatch.chdir(FOLDER)
    settings = ("sensor=reference_pose", "off_tracking=scan_matching:ScanMatching")
    with pytest.raises(ValueError, match="needs sensor = range_scanner:RangeScanner"):
        assemble(load_scenario("roundabout", settings), 1)
