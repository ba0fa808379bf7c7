"""Labelled sequences: consistent kinematics, and sand of the kind that its name says."""

import math

import numpy as np
import pytest

from sensors.sand.field import TILE, Field, Reach, foreign_tracks
from sensors.sand.grid import Sand, Window
from sensors.sand.relief import KINDS, Pebbles, Relief, SandKind
from sensors.sand.rover_pass import FRAME_TICKS, RoverPass, bare_stretches, labelled_sequence, recorded, route_of
from sensors.sand.solids import scattered
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import nominal_rig
from sensors.sand.world import SandWorld
from sensors.world.sky import daylight
from vehicle.clock import TICK
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.terrain import Mound, Terrain
from vehicle.rover.truth import RoverTruth

SIDE_SLOPE = Terrain(slope_y=math.tan(math.radians(5.0)))


@pytest.fixture(scope="module")
def rover() -> Rover:
    return load_rover("el_dorado_ii")


@pytest.fixture(scope="module")
def truths(rover: Rover) -> list[RoverTruth]:
    return RoverPass(frames=300, profile="fast", onset=10.0).truths(rover, SIDE_SLOPE, np.random.default_rng(2))


def test_wheels_travel_along_heading_plus_slip_angle(rover: Rover, truths: list[RoverTruth]) -> None:
    """For every wheel, so that the trace in the image agrees with the label."""
    places = np.array([t.wheel_positions[:, :2] for t in truths])
    steps = places[2:] - places[:-2]
    travel = np.arctan2(steps[..., 1], steps[..., 0])
    label = np.array([t.wheel_headings + t.slip_angles for t in truths])[1:-1]
    error = np.degrees(travel - label)
    assert np.abs(error).max() < 0.3  # central differences over 0.4 s of a slip that changes by 1 deg/s at most
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_wheels_turn_as_their_slip_ratios_say(rover: Rover, truths: list[RoverTruth]) -> None:
    """s = (r omega - v) / (r omega), and the angles rolled are the integral of omega."""
    truth = truths[100]
    rolling = rover.radius * truth.wheel_speeds
    np.testing.assert_allclose((rolling - truth.wheel_velocities[:, 0]) / rolling, truth.slip_ratios, atol=1e-9)
    turned = truths[101].wheel_turns - truth.wheel_turns
    np.testing.assert_allclose(turned, FRAME_TICKS * TICK * truth.wheel_speeds, rtol=1e-9)


def test_body_stands_on_the_slope(truths: list[RoverTruth]) -> None:
    """Its z axis is the ground's normal but for the shake of 0.2 deg, and it lies below the ground by the sinkage."""
    up = np.array([t.X_WB[:3, 2] for t in truths])
    normal = np.array([0.0, -math.sin(math.radians(5.0)), math.cos(math.radians(5.0))])
    assert np.degrees(np.arccos(np.clip(up @ normal, -1.0, 1.0))).max() < 1.5  # 5 sigma of two axes
    truth = truths[0]
    ground = SIDE_SLOPE.height(*truth.wheel_positions[:, :2].T)
    np.testing.assert_allclose(ground - truth.wheel_positions[:, 2], truth.sinkages, atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slow_slip_is_zero_until_its_onset_and_then_grows(seed: int) -> None:
    """As in Fig. 8 of Reina 2008: no drift on the first part of the path, then a drift of some degrees."""
    slip = np.degrees(
        np.abs(RoverPass(frames=435, profile="slow", onset=40.0).slip_angles(np.random.default_rng(seed)))
    )
    assert slip[:150].max() < 1.2  # 0.25 deg of noise about nothing
    assert slip[-50:].min() > 3.0
    rate = np.abs(np.diff(np.convolve(slip, np.ones(5) / 5.0, "valid"))) / (FRAME_TICKS * TICK)
    assert rate.max() < 0.6  # [deg/s]


def test_fast_slip_varies_as_prescribed() -> None:
    """6 to 11 deg, with a standard deviation of 1.6 deg within a pass; over 20 passes of 120 s."""
    passes = [
        np.degrees(RoverPass(frames=600, profile="fast", onset=0.0).slip_angles(np.random.default_rng(seed)))[100:]
        for seed in range(20)
    ]
    means = np.abs([one.mean() for one in passes])
    assert 5.0 < means.min() < means.max() < 12.0
    assert np.mean([one.std() for one in passes]) == pytest.approx(1.5, abs=0.4)  # smoothing takes some
    assert {float(np.sign(one.mean())) for one in passes} == {-1.0, 1.0}


def test_bare_stretches_have_their_share() -> None:
    stretches = bare_stretches(np.random.default_rng(1), 400.0, 0.3)
    assert sum(end - start for start, end in stretches) / 400.0 == pytest.approx(0.3, abs=0.03)
    assert min(end - start for start, end in stretches) > 1.0
    assert bare_stretches(np.random.default_rng(1), 400.0, 0.0) == ()


@pytest.mark.slow
def test_labels_and_images_agree_on_the_presence_of_a_trace(rover: Rover) -> None:
    """A wheel that does not sink leaves no trace; in uniform sand only lug marks are rough."""
    rover_pass = RoverPass(frames=120, profile="none", bare=((0.9, 3.0),))
    truths = rover_pass.truths(rover, Terrain(), np.random.default_rng(1))
    world = SandWorld("uniform", rng=np.random.default_rng(2), rover=rover, terrain=Terrain(), route=route_of(truths))
    camera = TraceCamera(world, nominal_rig(rover), Webcam(), np.random.default_rng(3))
    shares, roughness = [], []
    for start, end in ((0, 50), (50, 97), (97, 120)):
        world.drive(truths[start:end])
        shares.append(world.trace_truth(truths[end - 1]).share)
        stripe = camera.sample(truths[end - 1])[100:300, 290:350].astype(float)
        roughness.append(np.abs(stripe[4:] - stripe[:-4]).mean())
    assert shares[0] == 1.0
    assert 0.3 < shares[1] < 0.8  # the crust began 0.33 m behind the wheel's present place
    assert shares[2] == 0.0
    assert roughness[0] > roughness[1] > roughness[2]
    assert roughness[0] > 2.0 * roughness[2]


def test_a_view_may_be_taken_before_the_first_motion(rover: Rover) -> None:
    """A sequence without a lead, or a camera that is sampled twice at one place: no motion is no error."""
    truths = RoverPass(frames=3, profile="none").truths(rover, Terrain(), np.random.default_rng(1))
    rng = np.random.default_rng(2)
    views = recorded(truths, "uniform", rng=rng, rover=rover, terrain=Terrain())
    assert next(views).view.tick == truths[0].tick


@pytest.mark.slow
def test_a_sequence_is_labelled_frame_by_frame(rover: Rover) -> None:
    """View, truth and trace of one tick, 5 Hz apart; the same seed gives the same bits."""
    frames, again = (list(labelled_sequence("uniform", seed=5, frames=2, rover=rover, bare=0.0)) for _ in range(2))
    for frame in frames:
        assert frame.view.tick == frame.truth.tick == frame.trace.tick
        assert frame.trace.present
        assert frame.trace.wheel_slip == frame.truth.slip_angles[2]
    assert frames[1].view.tick - frames[0].view.tick == FRAME_TICKS
    assert np.array_equal(frames[1].view.image, again[1].view.image)
    assert frames[1].view.heading == again[1].view.heading


def test_ground_is_continuous_across_tiles() -> None:
    """Relief, pebbles and foreign tracks: steps across a border are as large as elsewhere."""
    light, route = daylight(0.4), np.array([[-1.0, 0.0], [1.5, 0.2]])
    kind = SandKind(stones=2500.0, ripples=0.002)
    rng = np.random.default_rng(3)
    field = Field(
        relief=Relief.draw(rng, kind, Terrain(mounds=(Mound(x=0.5, y=0.4, height=0.2, radius=0.5),)), 0.3),
        sun=light,
        tracks=foreign_tracks(rng, route, 0.0),
        rocks=(),
        reach=Reach.of(light),
    )
    height = field.height(Window(0, TILE - 100, TILE, TILE + 100))
    steps = np.abs(np.diff(height, axis=1)).mean(axis=0)
    assert steps[99] < 1.5 * np.median(steps)  # the mean of 512 rows, of which any column has its own pebbles


def test_sand_forgets_what_was_used_least_recently(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded: the sand in use keeps its imprints, far sand comes back undisturbed."""
    monkeypatch.setattr("sensors.sand.field._MOST", 4)
    light = daylight(0.4)
    relief = Relief.draw(np.random.default_rng(3), SandKind(stones=0.0), Terrain(), 0.0)
    field = Field(relief=relief, sun=light, tracks=(), rocks=(), reach=Reach.of(light))
    first, last = Window(0, 0, TILE, TILE), Window(0, 9 * TILE, TILE, 10 * TILE)
    undisturbed = field.height(first)
    field.write(first, Sand(undisturbed - 0.01, np.full(first.shape, 255, np.uint8)))
    for k in range(10):
        field.light(Window(100, k * TILE + 200, 300, k * TILE + 300))
        assert len(field.tiles) <= 4
    field.write(last, Sand(field.height(last) - 0.01, np.full(last.shape, 255, np.uint8)))
    assert field.sand(last).packed.all()
    assert np.array_equal(field.height(first), undisturbed)


def test_neighbouring_tiles_share_the_pebbles_on_their_border() -> None:
    pebbles = Pebbles.draw(np.random.default_rng(1), 3000.0)
    left, right = Window(0, 0, TILE, TILE), Window(0, TILE, TILE, 2 * TILE)
    of_left, of_right = ({(row, column) for row, column, *_ in pebbles.near(9, w)[0].tolist()} for w in (left, right))
    in_left = {(row, column - TILE) for row, column in of_left if column > TILE - 4}
    in_right = {(row, column) for row, column in of_right if column < 4}
    both = {(row, column) for row, column in of_right if abs(column) < 1}
    assert both
    assert both <= in_left | {(row, column - TILE) for row, column in in_left}
    assert both <= in_right


def test_rocks_leave_the_route_free() -> None:
    route = np.column_stack([np.linspace(0.0, 8.0, 200), 0.3 * np.sin(np.linspace(0.0, 6.0, 200))])
    rocks = scattered(np.random.default_rng(1), 4.0, route, Terrain())
    assert len(rocks) > 10
    for rock in rocks:
        distance = np.hypot(*(route - rock.place[:2]).T).min() - max(rock.radii[:2])
        assert distance > 0.44  # half the tread, half a wheel and a margin [m]


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_kind_is_drawn_from_its_seed(rover: Rover, name: str) -> None:
    route = np.array([[0.0, 0.0], [4.0, 0.0]])
    world = SandWorld(name, rng=np.random.default_rng(1), rover=rover, terrain=Terrain(), route=route)
    kind = KINDS[name]
    assert kind.azimuth[0] <= world.sun.azimuth <= kind.azimuth[1]
    assert kind.elevation[0] <= world.sun.elevation <= kind.elevation[1]
    assert bool(world.rocks) == bool(kind.rocks)


def test_foreign_tracks_lie_in_view_all_along_the_path() -> None:
    light, route = daylight(0.4), np.array([[0.0, 0.0], [4.0, 0.0]])
    relief = Relief.draw(np.random.default_rng(1), SandKind(stones=0.0), Terrain(), 0.0)
    tracks = foreign_tracks(np.random.default_rng(2), route, 0.275)
    field = Field(relief=relief, sun=light, tracks=tracks, rocks=(), reach=Reach.of(light))
    for start in (400, 1400, 2400):
        assert field.sand(Window(0, start, 550, start + 1000)).packed.mean() > 10.0  # of 255: a track takes a tenth


def test_unknown_kinds_are_refused(rover: Rover) -> None:
    route = np.array([[0.0, 0.0], [4.0, 0.0]])
    with pytest.raises(ValueError, match="terrain = 'snow' must be one of uniform"):
        SandWorld("snow", rng=np.random.default_rng(1), rover=rover, terrain=Terrain(), route=route)
