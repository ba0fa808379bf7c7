"""Faults of the combination's own sensors: their effect on the signals, their time, and who can have them."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable

import numpy as np
import pytest

from scenarios.assembly.trailer_run import assemble
from scenarios.options.scenario import load_scenario
from sensors.faults.fault import FAULTS, Fault, FaultContext, checked_kind
from sensors.faults.signal_kinds import SignalFault
from sensors.messages import CombinationSignals, StereoFrame

UNIT = 1  # of a tractor and its trailer


def faulty(name: str, amount: tuple[float, ...] = ()) -> list[CombinationSignals]:
    """Signals at 0, 0.5, … 2.5 s; the fault is active at 1 s and 1.5 s. The hitch angle grows by 0.1 rad a sample."""
    module, _, kind = FAULTS[name].partition(":")
    fault = Fault(
        name=name,
        kind=checked_kind(name, getattr(importlib.import_module(module), kind)),
        amount=amount,
        start=1.0,
        duration=1.0,
    )
    rng = np.random.default_rng(0)
    built = fault.built(FaultContext(message=CombinationSignals, camera=None, unit=UNIT, rng=rng))
    assert isinstance(built, SignalFault)
    return [built.degraded(sound(k), fault.active(sound(k).tick)) for k in range(6)]


def sound(k: int) -> CombinationSignals:
    return CombinationSignals(
        tick=500 * k,
        angles=np.zeros(1),
        speed=5.0,
        steer=0.0,
        articulation=np.array([0.1 * k]),
        yaw_rates=np.array([0.2, 0.3]),
        lateral_acceleration=0.0,
    )


@pytest.mark.parametrize(
    ("name", "amount", "read", "expected"),
    [
        ("articulation_offset", (9.0,), lambda s: s.articulation[0], [0.2 + math.radians(9), 0.3 + math.radians(9)]),
        ("articulation_stuck", (), lambda s: s.articulation[0], [0.1, 0.1]),
        ("gyro_bias", (-3.0,), lambda s: s.yaw_rates[1], [0.3 - math.radians(3)] * 2),
        ("gyro_drift", (2.0,), lambda s: s.yaw_rates[1], [0.3, 0.3 + math.radians(1)]),
        ("wheel_speed_dropout", (), lambda s: s.speed, [0.0, 0.0]),
    ],
)
def test_a_fault_changes_its_signal_in_its_time(
    name: str, amount: tuple[float, ...], read: Callable[[CombinationSignals], float], expected: list[float]
) -> None:
    """And no other: the tractor's gyro stays as it is."""
    signals = faulty(name, amount)
    values = [float(read(one)) for one in signals]
    assert values[2:4] == pytest.approx(expected)
    for k in (0, 1, 4, 5):
        assert values[k] == float(read(sound(k)))
    assert all(one.yaw_rates[0] == 0.2 for one in signals)


def test_cameras_cannot_have_a_fault_of_signals() -> None:
    """One line says what it needs."""
    kind = checked_kind("gyro_bias", importlib.import_module("sensors.faults.signal_kinds").GyroBias)
    context = FaultContext(message=StereoFrame, camera=None, unit=UNIT, rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"gyro_bias needs a combination's own sensors; .* sends StereoFrame"):
        Fault(name="gyro_bias", kind=kind).built(context)


def test_faults_of_a_scenario_act_on_the_signals_of_the_law() -> None:
    """Same seed, same noise: only the faulty signals differ."""
    sound, ill = law_signals(), law_signals("faults=articulation_offset:10; wheel_speed_dropout")
    assert ill.articulation - sound.articulation == pytest.approx(math.radians(10.0))
    assert (ill.speed, ill.steer) == (0.0, sound.steer)
    assert np.array_equal(ill.yaw_rates, sound.yaw_rates)


def law_signals(*settings: str) -> CombinationSignals:
    """The first signals that the law of the last trailer receives."""
    parts = assemble(load_scenario("roundabout", ("off_tracking=truth", *settings)), 1)
    truth = parts.plant.observe(parts.plant.initial_state(parts.course.start, parts.start_speed), 0)
    return parts.trailers[-1].signals.sample(truth)
