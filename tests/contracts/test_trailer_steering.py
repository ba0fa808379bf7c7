"""The contract of every trailer steering law of the catalogue."""

import inspect
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.policy import Network, feature_names, save_network
from estimators.estimates import Health, OffTracking
from offtrack.studies.tuning import defaults_of
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.catalogue import TRAILER_STEERING, resolve
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION
from tests.trailers import TWO_OF_THREE as TRAILER
from tests.trailers import estimate as some_estimate
from tests.trailers import signals as readings
from vehicle.frames import FloatArray
from vehicle.option import Option, Parameter, arguments, declared_options

PERIOD = 20  # between two steps of a controller [ticks]
CAMERA = 100  # between two estimates, and their latency [ticks]


def estimate(tick: int, *, turn: float, health: Health = Health.OK, speed: float = 2.8) -> OffTracking:
    """An estimate as on a circle of curvature ``turn`` [1/m], the rear 0.3 m inside of the hitch's path."""
    s = np.linspace(0.0, 16.0, 60)
    value, std = (0.0, np.inf) if health is Health.LOST else (-0.3 * float(np.sign(turn)), 0.01)
    return some_estimate(
        tick,
        value=value,
        std=std,
        health=health,
        path=np.column_stack([-s, -0.5 * turn * s**2]),
        hitch_direction=7.0 * turn,
        hitch_direction_rate=0.1 * turn,
        path_tangent=-7.0 * turn,
        v_x=speed,
        v_y=7.0 * turn * speed,
        yaw_rate=speed * turn,
    )


def mirrored(e: OffTracking) -> OffTracking:
    return replace(
        e,
        value=-e.value,
        path=e.path * [1.0, -1.0],
        hitch_direction=-e.hitch_direction,
        hitch_direction_rate=-e.hitch_direction_rate,
        path_tangent=-e.path_tangent,
        v_y=-e.v_y,
        yaw_rate=-e.yaw_rate,
    )


def signals(tick: int, angles: FloatArray, *, turn: float, speed: float = 2.8) -> CombinationSignals:
    """Readings on the circle of curvature ``turn`` [1/m]: wheelbase 3.8 m, trailer 9.3 m."""
    return readings(
        tick,
        angles=angles,
        speed=speed,
        steer=float(np.arctan(3.8 * turn)),
        articulation=np.array([np.arctan(9.3 * turn)]),
        yaw_rates=np.full(2, speed * turn),
        lateral_acceleration=speed**2 * turn,
    )


def drive(
    law: TrailerSteering[Any],
    estimates: dict[int, OffTracking],
    until: int,
    side: float = 1.0,
    *,
    turn: float = 0.08,
    speed: float = 2.8,
) -> FloatArray:
    """Commands (steps, axles) of the law with perfect actuators, estimates arriving at their ticks."""
    memory, newest, angles, commands = law.init(), None, np.zeros(2), []
    for tick in range(0, until, PERIOD):
        newest = estimates.get(tick, newest)
        seen = newest if newest is None or side > 0 else mirrored(newest)
        memory, command = law.step(memory, tick, seen, signals(tick, angles, turn=side * turn, speed=speed))
        angles = command.angles
        commands.append(angles.copy())
    return np.array(commands)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> str:
    """File of a linear policy that steers by articulation and off-tracking; one without bias is odd."""
    names = feature_names(2, [unit.name for unit in COMBINATION.vehicle.units])
    weights = np.zeros((2, len(names)))
    weights[:, names.index("articulation_1")] = -0.6, -1.0
    weights[:, names.index("off_tracking")] = 0.4
    file = tmp_path_factory.mktemp("policy") / "linear.npz"
    save_network(Network((weights,), (np.zeros(2),), np.zeros(len(names)), np.ones(len(names)), names), file)
    return str(file)


@pytest.fixture(params=sorted(TRAILER_STEERING))
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def law(name: str, network: str) -> TrailerSteering[Any]:
    """The law as scenarios construct it: guarded, and locked in reverse."""
    return trailer_law(name, TRAILER, COMBINATION, {"path": network} if name == "policy" else {})


@pytest.fixture
def bare(name: str, network: str) -> TrailerSteering[Any]:
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    keywords = arguments(part, {"path": network} if name == "policy" else {}, "steering")
    if "combination" in inspect.signature(part).parameters:
        keywords["combination"] = COMBINATION
    constructed: TrailerSteering[Any] = part(TRAILER, **keywords)
    return constructed


class Plain:
    def __init__(self, trailer: TrailerGeometry, *, gain: int = 1, mode: str | None = None, path: str = "") -> None:
        self.given = gain, mode, path

    def init(self) -> None:
        return

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        return None, SteerCommand(angles=np.zeros(2))


class Declared(Plain):
    """A user's law with declarations that its constructor does not check."""

    options = (Option("gain", 1.0, "gain", "rad/m", 0.0, 2.0),)


def test_parameters_are_declared_and_kept_within_their_limits(name: str) -> None:
    """Each has a meaning, a default within its limits, and a tuning range within them; a value beyond is refused."""
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    assert SteeringLaw in part.__mro__
    for option in declared_options(part):
        assert option.meaning
        if option.default is None:
            assert option.default_text
        else:
            option.check(option.default, option.name)
        if option.tune:
            assert option.low <= option.tune[0] < option.tune[1] <= option.high
        beyond: Parameter = 2.0 * option.high + 1.0 if option.kind is float else 0
        for wrong in (beyond, math.nan):
            with pytest.raises(ValueError, match=rf"^steering\.{option.name} = {wrong}\b.* must be "):
                trailer_law(name, TRAILER, COMBINATION, {option.name: wrong})


def test_a_law_without_declarations_can_be_used() -> None:
    law = trailer_law(f"{__name__}:Plain", TRAILER, COMBINATION, {"gain": 2.5, "mode": "fast"})
    own: Any = law.law
    assert own.given == (2.5, "fast", "")
    assert defaults_of(Plain) == {"gain": 1.0}


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        (f"{__name__}:Declared", {"gain": 3.0}, r"^steering\.gain = 3\.0 rad/m must be between 0 and 2 rad/m$"),
        (f"{__name__}:Plain", {"gian": 1.0}, r"^unknown key 'steering\.gian'; did you mean 'gain'\?$"),
        ("policy", {}, r"^key 'steering\.path' is missing$"),
    ],
)
def test_wrong_parameters_are_refused_in_one_line(name: str, parameters: dict[str, Parameter], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        trailer_law(name, TRAILER, COMBINATION, parameters)


@pytest.mark.parametrize("name", sorted(set(TRAILER_STEERING) - {"none", "policy"}))
def test_a_trailer_without_steered_axles_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no steered axle"):
        trailer_law(name, replace(TRAILER, steered=(False,) * 3), COMBINATION, {})


TURN = {k: estimate(k - CAMERA, turn=0.08) for k in range(CAMERA, 4000, CAMERA)}


def assert_within_limits(commands: FloatArray) -> None:
    assert np.isfinite(commands).all()
    assert np.abs(commands).max() <= TRAILER.max_steer + 1e-12


def test_commands_stay_finite_and_within_the_actuators_limits(name: str, law: TrailerSteering[Any]) -> None:
    """A demand beyond what the axles can do would hide in the actuators; rates get a rounding's allowance."""
    commands = drive(law, TURN, 4000)
    assert_within_limits(commands)
    law_of = resolve("trailer_steering", name, TRAILER_STEERING)
    rate = np.inf if getattr(law_of, "beyond_reach", False) else TRAILER.max_steer_rate
    assert np.abs(np.diff(commands, axis=0)).max() <= rate * PERIOD * 1e-3 + 1e-9


def test_nothing_is_commanded_before_anything_is_known(law: TrailerSteering[Any]) -> None:
    """Without a first estimate, and straight ahead, the trailer must stay a plain trailer."""
    unfilled = {k: estimate(k - CAMERA, turn=0.0, health=Health.LOST) for k in range(CAMERA, 2000, CAMERA)}
    assert not drive(law, {}, 1000, turn=0.0).any()
    assert not drive(law, unfilled, 2000, turn=0.0).any()


@pytest.mark.slow
def test_losing_the_estimate_for_good_ends_with_straight_wheels(law: TrailerSteering[Any]) -> None:
    """Old news must not steer a trailer forever: straight ahead, without an estimate, the axles become straight.

    The trailer rolls without slip, so that signals fit together and integrals unwind. It straightens exponentially, and
    so do axles steered by its articulation, which no angle that is kept does. The estimates, of another circle,
    have taught the fallback a gyro's bias of 1 mrad/s: 0.2 degrees of steer.
    """
    memory, newest, angles, folded = law.init(), None, np.zeros(2), math.atan(9.3 * 0.08)
    largest = []  # angle of every step [rad]
    for tick in range(0, 20000, PERIOD):
        newest = TURN.get(tick, newest) if tick < 2000 else newest
        turn = 0.08 * min(1.0, max(0.0, (4000 - tick) / 2000))
        yaw_rate = 2.8 * (math.sin(folded) - math.cos(folded) * np.tan(angles).sum() / 3.0) / 9.3
        read = signals(tick, angles, turn=turn)
        read = replace(read, articulation=np.array([folded]), yaw_rates=np.array([2.8 * turn, yaw_rate]))
        memory, command = law.step(memory, tick, newest, read)
        angles = command.angles
        largest.append(float(np.abs(angles).max()))
        folded += (2.8 * turn - yaw_rate) * PERIOD * 1e-3
    assert largest[-1] < 5e-3
    assert largest[-1] <= 0.1 * max(largest)


@pytest.mark.slow
def test_swapping_left_and_right_flips_the_commands(law: TrailerSteering[Any]) -> None:
    """Mirror symmetry pins all the signs at once; exact, since every operation is odd or even."""
    np.testing.assert_allclose(drive(law, TURN, 4000, side=-1.0), -drive(law, TURN, 4000), atol=1e-9)


def test_a_step_is_pure_and_law_and_memory_travel(law: TrailerSteering[Any]) -> None:
    """Copies go on as the originals, to the last bit; the memory given is not changed, and gives the same again."""
    memory = law.init()
    for tick in range(0, 2000, PERIOD):
        memory, _ = law.step(memory, tick, TURN.get(tick), signals(tick, np.zeros(2), turn=0.08))
    before = pickle.dumps((law, memory))
    copy, copied = pickle.loads(before)
    law.step(memory, 2000, TURN[2000], signals(2000, np.zeros(2), turn=0.08))
    assert pickle.dumps((law, memory)) == before
    for tick in range(2000, 2400, PERIOD):
        reading = signals(tick, np.zeros(2), turn=0.06)
        memory, command = law.step(memory, tick, TURN.get(tick), reading)
        copied, again = copy.step(copied, tick, TURN.get(tick), reading)
        np.testing.assert_array_equal(again.angles, command.angles)


@pytest.mark.slow
@pytest.mark.parametrize("points", [1, 2, 60])
def test_lost_estimates_never_make_a_command_infinite(bare: TrailerSteering[Any], points: int) -> None:
    """From the start, and in between good ones; the path of a lost one may be the hitch alone."""
    lost = {
        k: replace(seen, health=Health.LOST, value=0.0, std=np.inf, path=seen.path[:points], v_x=0.0, v_y=0.0)
        for k, seen in TURN.items()
        if k < 500 or 2000 <= k < 3000
    }
    assert_within_limits(drive(bare, TURN | lost, 4000))


@pytest.mark.parametrize("speed", [0.0, 1e-9, -1.0])
def test_standstill_and_reversing_are_survived(law: TrailerSteering[Any], speed: float) -> None:
    still = {k: estimate(k - CAMERA, turn=0.08, speed=speed) for k in range(CAMERA, 2000, CAMERA)}
    assert_within_limits(drive(law, still, 2000, speed=speed))
