"""Physics of environments: that of the scenarios, for any number of vehicles."""

import math
from typing import Any, Literal

import gymnasium
import numpy as np
import pytest

from controllers.driver import PERIOD, PreviewDriver
from offtrack.environments import rewards
from offtrack.environments.observations import Encoders, HitchPaths
from offtrack.environments.rewards import N_DRAWN, Domain, Moment, Variation, narrowed
from offtrack.environments.trailer_steering import named_course
from scenarios.assembly.adapters import course_of, tractor_guided_at
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import true_off_tracking
from sensors.instruments.navigation import DriverPerception
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchMotion
from vehicle.combination.description import load_vehicle
from vehicle.combination.functions import numbers
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.surface import Surface

VEHICLE = load_vehicle("uk_longer_semitrailer")
STEP = to_ticks(PERIOD, "period")
NOMINAL = {"cross_fall": 0.0, "load": 1.0, "length": 1.0, "actuator_lag": 1.0, "sensor_error": 0.0}


def drawn(**values: float) -> Any:
    """Circumstances of one episode."""
    domain = narrowed(Domain(), {**NOMINAL, "friction": 0.8, "speed": 3.0, **values})
    return domain.drawn(np.zeros((1, N_DRAWN)))


@pytest.mark.slow
def test_an_episode_is_what_plant_and_driver_of_a_scenario_do() -> None:
    """Twelve seconds into a roundabout with cross-fall at 20 km/h, trailer axles straight, against plant and driver.

    The course is a table here and its project one step of Newton's: some hundredths of a millimetre. Off-tracking is
    told from points 0.1 m apart: a tenth of a millimetre on a circle of 10 m.
    """
    course = course_of(load_scenario("roundabout"), VEHICLE)
    plant = Plant(VEHICLE, Surface(friction=0.6, cross_fall=0.03, centre=course.surface_centre))
    speed = math.sqrt(0.5 * 9.81 * 0.6 / (1.0 / 12.5))
    driver = PreviewDriver(tractor_guided_at(VEHICLE, course.reference), course.path, min(speed, 5.0))
    state, memory = plant.initial_state(course.start, min(speed, 5.0)), driver.init()
    env = gymnasium.make("offtrack/TrailerSteering-v0", observation="truth", disable_env_checker=True)
    given = {**NOMINAL, "cross_fall": 0.03, "friction": 0.6, "speed": 5.0, "course": "roundabout"}
    env.reset(seed=1, options=given)
    core = env.unwrapped.core  # type: ignore[attr-defined]
    poses, told = [], []
    for k in range(600):
        truth = plant.observe(state, k * STEP)
        poses.append(truth.poses[1])
        memory, demand = driver.step(memory, k * STEP, DriverPerception().sample(truth))
        state = plant.step(state, VehicleCommand(demand.steer, demand.acceleration, (0.0, 0.0)), STEP)
        *_, info = env.step(np.zeros(2, dtype=np.float32))
        told.append(info["off_tracking"])
    x, y, psi = np.array([*poses, plant.observe(state, 0).poses[1]]).T
    true = true_off_tracking(x, y, psi, 14.0)[1:]
    assert core._motion.poses[0] == pytest.approx(plant.observe(state, 0).poses, abs=1e-3)
    assert np.nanmax(np.abs(true)) > 1.0
    assert np.array(told)[np.isfinite(true)] == pytest.approx(true[np.isfinite(true)], abs=2e-3)


@pytest.mark.slow
def test_left_and_right_are_mirror_images() -> None:
    """On the mirrored roundabout every lateral quantity of the observation flips, and nothing else does."""
    seen = []
    for course, side in (("roundabout", 1.0), ("roundabout-right", -1.0)):
        env = gymnasium.make("offtrack/TrailerSteering-v0", observation="truth", disable_env_checker=True)
        env.reset(seed=1, options={**NOMINAL, "friction": 0.3, "speed": 3.0, "course": course, "cross_fall": 0.02})
        for _ in range(600):
            observation, *_ = env.step(np.array([-0.2, -0.5], dtype=np.float32) * np.float32(side))
        seen.append(observation)
        names = [feature.name for feature in env.unwrapped.core.features]  # type: ignore[attr-defined]
    even = {"hitch_v_x", "age", "usable", "speed", "follow_distance"}
    flipped = np.where([name in even for name in names], 1.0, -1.0) * seen[1]
    assert np.abs(seen[0][0]) > 0.1  # it does something
    assert flipped == pytest.approx(seen[0], abs=1e-5)  # rounding of 32 bits


def test_a_half_laden_vehicle_has_the_numbers_of_one_with_half_its_trailers_mass() -> None:
    """What moves by them moves as a plant of its own (tests/vehicle/combination/test_batch.py)."""
    trailer = VEHICLE.units[1]
    assert trailer.roll is not None
    roll = trailer.roll.model_copy(update={"inertia": 0.5 * trailer.roll.inertia})
    lighter = {"mass": 0.5 * trailer.mass, "yaw_inertia": 0.5 * trailer.yaw_inertia, "roll": roll}
    own = VEHICLE.model_copy(update={"units": (VEHICLE.units[0], trailer.model_copy(update=lighter))})
    assert Variation(VEHICLE).numbers(drawn(load=0.5))[0] == pytest.approx(numbers(own), rel=1e-12)


def test_encoders_err_throughout_an_episode_as_much_as_their_data_sheet_says() -> None:
    """Biases of 0.1 deg and 0.1 deg/s, 1 sigma, over 500 episodes; 3 sigma of such a sample's deviation are 10 %."""
    encoders, n = Encoders(500, 2), 500
    encoders.begin(np.arange(n), [np.random.default_rng(k) for k in range(n)], np.ones(n))
    seen = BatchMotion(*(np.zeros((n, *shape)) for shape in ((2, 3), (2, 3), (3,), (2,))))
    for errors in encoders.read(seen):
        assert np.degrees(errors.std()) == pytest.approx(0.1, rel=0.1)
    np.testing.assert_equal(encoders.read(seen), encoders.read(seen))


def test_a_longer_trailer_is_longer_everywhere() -> None:
    """Its follow point, end and axles move back by the same way, and the hitch keeps its share of the load."""
    variation = Variation(VEHICLE)
    row, nominal = variation.numbers(drawn(length=1.05))[0], numbers(VEHICLE)
    assert variation.follow_distance(drawn(length=1.05)) == pytest.approx([14.7])
    assert sorted(set(np.round((nominal - row)[np.isclose(nominal - row, 0.7)], 6))) == [0.7]
    assert np.isclose(nominal - row, 0.7).sum() == 7  # three axles, two centres of their wheels' axes, point and end


def test_off_tracking_beside_a_circle_is_the_closed_form() -> None:
    """A point straight behind the hitch, heading along the tangent: the circle lies R - sqrt(R^2 - L^2) inside.

    Points of the path are 0.1 m apart: a chord between two of them would be 0.01/(8 R) = 0.125 mm inside the circle.
    They lie on chords of 0.03 m that are 0.01 mm inside, which 1/cos of the path's direction makes 0.02 mm.
    """
    radius, length = 10.0, 8.0
    angles = np.arange(0.0, 2.0, 0.003)
    poses = np.column_stack([radius * np.sin(angles), radius * (1.0 - np.cos(angles)), angles])
    paths = HitchPaths(2, 14.0)  # the other one goes straight ahead
    paths.begin(np.arange(2), np.zeros((2, 3)), np.array([length, 14.0]))
    for k, pose in enumerate(poses[1:]):
        offsets = paths.step(np.array([pose, [0.03 * k, 0.0, 0.0]]))
    assert offsets.offset[1] == pytest.approx(0.0, abs=1e-12)
    assert offsets.offset[0] == pytest.approx(radius - math.sqrt(radius**2 - length**2), abs=3e-5)
    assert offsets.direction[0] == pytest.approx(
        -math.asin(length / radius), abs=1e-3
    )  # 0.01 mm over a chord of 0.1 m, ten times


def test_options_narrow_the_domain_and_seeds_and_numbers_decide() -> None:
    """The same seed with one thing given keeps all else, so that its effect alone is seen."""
    uniform = np.random.default_rng(1).random((1, N_DRAWN))
    wide = Domain().drawn(uniform)
    given = narrowed(Domain(), {"friction": 0.3}).drawn(uniform)
    assert given.friction == pytest.approx([0.3])
    assert given._replace(friction=wide.friction) == wide
    values = Domain().drawn(np.random.default_rng(1).random((1000, N_DRAWN)))  # evenly: to a hundredth of the ends
    for name, column in values._asdict().items():
        low, high = getattr(Domain(), name)
        assert [column.min(), column.max()] == pytest.approx([low, high], abs=0.01 * (high - low))
    first, again, other = (named_course(name, VEHICLE) for name in ("random-3", "random-3", "random-4"))
    assert first.path == again.path != other.path


def moment(**values: Any) -> Moment:
    shapes = {"steer_rate": (1, 2), "articulation": (1, 1), "load_transfer": (1, 2)}
    nothing = {name: np.zeros(shapes.get(name, (1,))) for name in Moment._fields}
    return Moment(**nothing | {"speed": np.ones(1), "finite": np.ones(1, dtype=bool)} | values)


def test_rewards_cost_nothing_at_best_and_have_their_units() -> None:
    """Each part by hand; a left turn whose path lies left of the follow point has it outside."""
    for part in (rewards.follow_error, rewards.outside_path, rewards.kerb, rewards.steer_effort):
        assert part(moment())[0] == 0.0
    assert rewards.follow_error(moment(off_tracking=np.array([0.2])))[0] == pytest.approx(-0.04)
    assert rewards.follow_error(moment(off_tracking=np.array([50.0])))[0] == pytest.approx(-9.0)
    outside = moment(off_tracking=np.array([0.2]), curvature=np.array([0.1]))
    assert rewards.outside_path(outside)[0] == pytest.approx(-0.2)
    assert rewards.outside_path(outside._replace(curvature=-outside.curvature))[0] == 0.0
    assert rewards.kerb(moment(off_tracking=np.array([-0.6])))[0] == -1.0
    assert rewards.steer_effort(moment(steer_rate=np.array([[0.1, 0.3]])))[0] == pytest.approx(-0.05)
    both = rewards.weighted({rewards.kerb: 2.0, rewards.follow_error: 1.0})
    assert both(moment(off_tracking=np.array([1.0])))[0] == pytest.approx(-3.0)


def test_endings_are_met_at_their_limits() -> None:
    for ending, name, harmless, bad in (
        (rewards.jackknifed, "articulation", [[1.5]], [[-1.6]]),
        (rewards.rolled_over, "load_transfer", [[0.1, 0.97]], [[0.1, -0.99]]),
        (rewards.left_the_road, "road_offset", [4.4], [-4.6]),
        (rewards.diverged, "finite", [True], [False]),
    ):
        assert not ending(moment(**{name: np.array(harmless)}))[0]
        assert ending(moment(**{name: np.array(bad)}))[0]


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("axles", [1, 2, 3, 5])
def test_rewards_do_not_depend_on_the_number_of_environments(axles: int, order: Literal["C", "F"]) -> None:
    """Bitwise: sums over axles are taken in one order."""
    rng = np.random.default_rng(axles)
    values: dict[str, Any] = {name: rng.normal(size=40) for name in Moment._fields}
    many = Moment(**values)._replace(steer_rate=np.asarray(rng.normal(size=(40, axles)), order=order))
    reward = rewards.weighted(rewards.USUAL)
    alone = [Moment(**{name: part[k : k + 1] for name, part in many._asdict().items()}) for k in range(40)]
    single = [float(reward(one)[0]) for one in alone]
    assert reward(many).tolist() == single
