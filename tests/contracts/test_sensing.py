"""Contracts of every odometry, off-tracking estimator and slip estimator of the catalogue, on rendered images."""

import dataclasses
import math
import pickle
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest

from estimators.context import (
    Estimator,
    FusesSignals,
    Odometry,
    OffTrackingEstimator,
    RoverContext,
    SlipEstimator,
    TrailerContext,
)
from estimators.estimates import CameraOffTracking, Health, Motion, OffTracking, SlipAngle
from scenarios.assembly.rover_run import rover_geometry
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, SLIP_ESTIMATOR, resolve
from scenarios.options.scenario import load_scenario
from sensors.camera.rig import StereoCalibration
from sensors.instruments.navigation import ExactPose, ExactSlip
from sensors.messages import StereoFrame, TrailerView, stereo_frame
from sensors.sand.rover_pass import Labelled, labelled_sequence
from sensors.sand.trace_rig import nominal_rig
from vehicle.combination.plant import VehicleCommand
from vehicle.rover.description import load_rover

FRAMES = 8  # too few to fill the buffer at 0.5 m each, enough for a steady odometry
STEP = 0.5  # 5 m/s at 10 Hz [m]
SIGNALS = 20  # between two messages of the combination's sensors [ticks]
# Share of the step that an increment may be off. A tenth of 2 % would already be a millimetre a frame. VISO2-S matches
# whole pixels: 2.44 % of the distance (de Saxe 2018, section 2.1), and here of images of half the size, twice that.
ACCURACY = defaultdict(lambda: 0.02, viso2=0.05)
SETTINGS = ("rig.width=672", "rig.height=240", "world.scenery_density=0.5")
VIEWS = 8  # of a rover: the trace is found in the second, and followed in all others


class Drive(NamedTuple):
    assembly: Assembly
    calibration: StereoCalibration | None  # None: its sensor is no stereo camera
    messages: dict[str, list[Any]]


def driven(*settings: str) -> Drive:
    """Straight drive at a constant slip; there is one renderer at a time, so it is closed in the end."""
    parts = assemble(load_scenario("constant-slip", [*SETTINGS, *settings]), seed=3)
    state = parts.plant.initial_state(parts.course.start, parts.scenario.speed)
    last = parts.trailers[-1]
    frames: list[StereoFrame] = []
    poses, signals, views, others = [], [], [], []
    for tick in range(0, 100 * FRAMES, SIGNALS):
        truth = parts.plant.observe(state, tick)
        signals.append(last.signals.sample(truth))
        message = last.sensing.sensor.sample(truth) if last.sensing.schedule.due(tick) else None
        if isinstance(message, TrailerView):
            views.append(message)
        elif message is not None:
            others.append(message)
        if (frame := stereo_frame(message)) is not None:
            frames.append(frame)
            poses.append(ExactPose(last.unit, last.path_height).sample(truth))
        state = parts.plant.step(state, VehicleCommand(0.0, 0.0, (0.0, 0.0)), SIGNALS)
    parts.close()
    sensor: str = resolve("off_tracking", parts.scenario.off_tracking, OFF_TRACKING).sensor
    messages: dict[str, list[Any]] = {
        sensor: frames or others,
        "reference_pose": poses,
        "combination_signals": signals,
        "views": views,
    }
    return Drive(parts, parts.cameras.calibration if parts.cameras else None, messages)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return driven()


@pytest.fixture(scope="module")
def under_the_trailer(drive: Drive) -> Drive:
    return driven("world.scenery_density=0", "off_tracking=ground_watching")


@pytest.fixture(scope="module")
def trace() -> list[Labelled]:
    return list(labelled_sequence("pebbles", seed=71, frames=VIEWS, rover=load_rover("el_dorado_ii"), bare=0.0))


@pytest.fixture(params=sorted(ODOMETRY))
def odometry_name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def odometry(odometry_name: str, drive: Drive) -> Odometry[Any]:
    part: Odometry[Any] = resolve("odometry", odometry_name, ODOMETRY)(drive.calibration)
    return part


def context(source: Drive, **changes: Any) -> TrailerContext:
    parts = source.assembly
    last, motions = parts.trailers[-1], resolve("odometry", parts.scenario.odometry, ODOMETRY)
    whole = TrailerContext(
        vehicle=parts.vehicle,
        unit=last.unit,
        follow_distance=last.geometry.follow_distance,
        calibration=source.calibration,
        odometry=motions(source.calibration) if source.calibration else None,
        rng=np.random.default_rng(3),
        options={},
        sensor=last.sensing.sensor,
    )
    return dataclasses.replace(whole, **changes)


@pytest.fixture(params=sorted(OFF_TRACKING))
def off_tracking(
    request: pytest.FixtureRequest, drive: Drive, under_the_trailer: Drive
) -> tuple[OffTrackingEstimator, list[Any]]:
    part: type[OffTrackingEstimator] = resolve("off_tracking", request.param, OFF_TRACKING)
    source = under_the_trailer if part.sensor == "ground_cameras" else drive
    if part.sensor not in source.messages:
        source = driven(f"off_tracking={request.param}")
    estimator = part.of(context(source))
    fuses = isinstance(estimator, FusesSignals) and estimator.fuses_signals
    return estimator, source.messages["views" if fuses else part.sensor]


@pytest.fixture(params=sorted(SLIP_ESTIMATOR))
def slip(request: pytest.FixtureRequest, trace: list[Labelled]) -> tuple[SlipEstimator, list[Any]]:
    part: type[SlipEstimator] = resolve("slip_estimator", request.param, SLIP_ESTIMATOR)
    rover = load_rover("el_dorado_ii")
    context = RoverContext(
        rover=rover_geometry(rover), rig=nominal_rig(rover), rng=np.random.default_rng(3), options={}
    )
    messages: dict[str, list[Any]] = {
        "trace_camera": [moment.view for moment in trace],
        "slip_reading": [ExactSlip(wheel=rover.rear_left).sample(moment.truth) for moment in trace],
    }
    return part.of(context), messages[part.sensor]


def run(estimator: Estimator[Any, Any, Any], messages: Sequence[Any], *, travelling: bool = False) -> list[Any]:
    """Memory and estimate after every message; ``travelling``: the memory is pickled between any two."""
    memory, results = estimator.init(), []
    for message in messages:
        if travelling:
            memory = pickle.loads(pickle.dumps(memory))
        memory, estimate = estimator.step(memory, message)
        results.append((memory, estimate))
    return results


def estimates(estimator: Estimator[Any, Any, Any], messages: Sequence[Any]) -> list[Any]:
    return [estimate for _, estimate in run(estimator, messages)]


def assert_same(a: Any, b: Any) -> None:
    """Equal to the bit, down to the fields of tuples and dataclasses and the entries of arrays."""
    assert type(a) is type(b)
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b or (a != a and b != b)  # two NaNs are the same


@pytest.mark.slow
def test_odometry_measures_the_step_between_frames(odometry: Odometry[Any], odometry_name: str, drive: Drive) -> None:
    """Half a metre a frame, every one of them; to the bit the same through pickled memories."""
    results = run(odometry, drive.messages["stereo_camera"])
    assert_same(results, run(odometry, drive.messages["stereo_camera"], travelling=True))
    first, *others = (estimate for _, estimate in results)
    assert first is None
    for motion in others:
        assert isinstance(motion, Motion)
        assert motion.health is not Health.LOST
        assert np.linalg.norm(motion.X_PC[:3, 3]) == pytest.approx(STEP, rel=ACCURACY[odometry_name])
        assert (np.linalg.eigvalsh(motion.covariance) > 0.0).all()
        assert motion.inliers <= motion.matches
        assert motion.tracks.shape == (motion.inliers, 4)


@pytest.mark.slow
def test_off_tracking_is_deterministic_and_its_memory_travels(
    off_tracking: tuple[OffTrackingEstimator, list[Any]],
) -> None:
    estimator, messages = off_tracking
    assert any(estimate is not None for estimate in estimates(estimator, messages))
    assert_same(run(estimator, messages), run(estimator, messages, travelling=True))


@pytest.mark.slow
def test_slip_is_deterministic_and_its_memory_travels(slip: tuple[SlipEstimator, list[Any]]) -> None:
    """The same views give the same slip to the bit, also through pickled memories; and there is a slip to compare."""
    assert_same(run(*slip), run(*slip, travelling=True))
    last = estimates(*slip)[-1]
    assert isinstance(last, SlipAngle)
    assert last.health is Health.OK


def test_off_tracking_is_lost_before_a_trailer_length_is_travelled(
    off_tracking: tuple[OffTrackingEstimator, list[Any]],
) -> None:
    """4 m of path do not reach back 14 m: the value is 0 and lost, not a guess; the path is what there is."""
    estimator, messages = off_tracking
    last: OffTracking | None = None
    for message, estimate in zip(messages, estimates(estimator, messages), strict=True):
        if estimate is not None:
            last = estimate.off_tracking if isinstance(estimate, CameraOffTracking) else estimate
            assert last.tick == message.tick
            assert last.health is Health.LOST
            assert last.value == 0.0
    assert last is not None
    assert np.linalg.norm(last.path[-1]) == pytest.approx((FRAMES - 1) * STEP, rel=0.02)
    assert last.v_x == pytest.approx(5.0 * math.cos(math.radians(14.0)), rel=0.02)


def test_a_context_without_cameras_is_refused(drive: Drive) -> None:
    blind = context(drive, calibration=None, odometry=None, sensor=None)
    parts = [resolve("off_tracking", name, OFF_TRACKING) for name in OFF_TRACKING]
    of_images = [part for part in parts if part.sensor in ("stereo_camera", "ground_cameras")]
    assert of_images
    for part in of_images:
        with pytest.raises(ValueError, match="needs a calibrated stereo pair"):
            part.of(blind)


@pytest.mark.parametrize("name", sorted(OFF_TRACKING))
def test_an_unknown_option_is_refused(name: str) -> None:
    message = r"unknown key '(viso_ot|estimator)\.unknown'"
    settings = [f"off_tracking={name}", f"{'viso_ot' if name == 'viso_ot' else 'estimator'}.unknown=1.0"]
    with pytest.raises(ValueError, match=message):
        assemble(load_scenario("constant-slip", [*SETTINGS, *settings]), seed=3)
