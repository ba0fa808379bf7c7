"""The reverse gear: what drives forward drives backward, and a pushed trailer runs away as its geometry says."""

import math

import numpy as np
import pytest

from offtrack.studies.validation.simple_drives import gripping, tractor_and_trailer
from tests.vehicle.chains import named
from vehicle.combination.batch import PlantBatch
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

DRY = Surface(friction=0.8)
ORIGIN = Pose2(0.0, 0.0, 0.0)
HELD = 20  # [ticks]


def drive(plant: Plant, state: FloatArray, seconds: float, command: VehicleCommand) -> FloatArray:
    """States every 20 ms, (n, n_state), the first one included."""
    states = [state]
    for _ in range(round(seconds * 1000) // HELD):
        states.append(plant.step(states[-1], command, HELD))
    return np.array(states)


def forward_speeds(vehicle: Vehicle, states: FloatArray) -> FloatArray:
    return np.array([named(vehicle, state).v_x[0] for state in states])


def between_equal_axles() -> Vehicle:
    """A truck that is its own mirror image front to back: two equal driven axles, everything else halfway."""
    truck = load_vehicle("rigid_truck")
    unit = truck.units[0]
    front = unit.axles[0].model_copy(update={"driven": True, "ackermann_x": None})
    middle = 0.5 * front.x
    half = middle + 1.4
    body = unit.model_copy(
        update={
            "cg_x": middle,
            "front_x": middle + half,
            "rear_x": middle - half,
            "axles": (front, front.model_copy(update={"x": 0.0, "steered": False})),
            "roll": unit.roll.model_copy(update={"frame_stiffness": None}) if unit.roll else None,
        }
    )
    return truck.model_copy(update={"units": (body,)})


def test_a_vehicle_alike_at_both_ends_goes_backward_as_the_turned_one_goes_forward() -> None:
    """Turned by 180 degrees it is the same vehicle: drive, load transfer, trail and relaxation all have to agree.

    It starts with a slide and a turn, and pulls through the engine's power limit and back down to a standstill.
    """
    vehicle = between_equal_axles()
    middle = vehicle.units[0].cg_x
    plant = Plant(vehicle, Surface(friction=0.5))
    ends = {}
    for way in (+1.0, -1.0):
        state = plant.initial_state(ORIGIN, way * 8.0)
        at = named(vehicle, state)
        at.v_y[0], at.yaw_rate[0] = way * 0.3 - middle * 0.15, 0.15  # of the middle: 0.3 m/s to the left as it goes
        pulled = drive(plant, state, 4.0, VehicleCommand(0.0, 1.4, (), way))
        braked = drive(plant, pulled[-1], 3.0, VehicleCommand(0.0, -2.5, (), way))
        seen = [named(vehicle, s) for s in (*pulled, *braked)]
        across = [s.v_y[0] + middle * s.yaw_rate[0] for s in seen]
        ends[way] = np.array([[way * s.v_x[0], way * v, s.yaw_rate[0]] for s, v in zip(seen, across, strict=True)])
    assert ends[+1.0][:, 0].max() > 12.0
    assert np.abs(ends[+1.0][10:50, 2]).max() > 0.01  # it really turns
    np.testing.assert_allclose(ends[-1.0], ends[+1.0], atol=1e-8)  # rounding, over 7000 ticks


def test_the_engine_reverses_within_its_power(tractor_semitrailer: Vehicle) -> None:
    """Work of the drive torques less rolling drag is what the moving and turning masses gain, at full power too."""
    drive_data = tractor_semitrailer.drive.model_copy(update={"max_power": 60e3})
    weak = tractor_semitrailer.model_copy(update={"drive": drive_data})
    plant = Plant(weak, DRY)
    states = drive(plant, plant.initial_state(ORIGIN, -4.0), 6.0, VehicleCommand(0.0, 1.0, (), -1.0))
    first, last = named(weak, states[100]), named(weak, states[-1])  # from 2 s on the demand is beyond the power
    inertia = sum(wheel.axle.wheel_inertia / wheel.axle.wheel_radius**2 for wheel in wheels(weak))
    gained = 0.5 * (weak.mass + inertia) * (last.v_x[0] ** 2 - first.v_x[0] ** 2)
    way = float(first.x[0] - last.x[0])
    dragged = 0.006 * GRAVITY * weak.mass * way
    assert last.v_x[0] < -4.4
    # Slip of the driven wheels takes 12 kN over 100 kN times 5.2, 2 %, of the power.
    assert gained + dragged == pytest.approx(60e3 * 4.0, rel=0.03)
    assert gained + dragged < 60e3 * 4.0


@pytest.mark.parametrize("grade", [0.08, -0.08])
def test_it_stops_from_reverse_holds_on_a_hill_and_goes_on(tractor_semitrailer: Vehicle, grade: float) -> None:
    """Brakes hold 40 t uphill and downhill without creep or chatter, and it moves off the way the gear says."""
    plant = Plant(tractor_semitrailer, Surface(friction=0.8, grade=grade))
    stopped = drive(plant, plant.initial_state(ORIGIN, -3.0), 14.0, VehicleCommand(0.0, -2.0, (), -1.0))
    late = forward_speeds(tractor_semitrailer, stopped[-200:])
    assert forward_speeds(tractor_semitrailer, stopped).max() < 0.3  # a rebound on tyres and brakes is all
    assert np.abs(late).max() < 2e-3
    assert abs(stopped[-1][0] - stopped[-200][0]) / 4.0 < 1e-3  # [m/s]
    for gear in (-1.0, 1.0):
        off = drive(plant, stopped[-1], 4.0, VehicleCommand(0.0, 1.4, (), gear))
        assert gear * forward_speeds(tractor_semitrailer, off)[-1] > 0.4


def test_a_pushed_trailer_turns_away_as_its_tractrix_does(tractor_semitrailer: Vehicle) -> None:
    """Straight back on stiff tyres: tan(gamma / 2) grows by e every trailer length, until it folds at a right angle.

    The trailer's turn is v sin(gamma) / L while the hitch goes straight; that integrates to the half tangent.
    """
    length, start = 7.7, math.radians(3.0)
    vehicle = gripping(tractor_and_trailer(tractor_semitrailer, length=length, hitch_x=0.0))
    plant = Plant(vehicle, DRY)
    state = plant.initial_state(ORIGIN, -1.0)
    at = named(vehicle, state)
    at.psi[1], at.yaw_rate[1] = -start, -math.sin(start) / length
    seen = []
    for _ in range(2000):
        v, gamma = -named(vehicle, state).v_x[0], float(np.diff(named(vehicle, state).psi)[0])
        seen.append((-state[0], -gamma))
        if -gamma >= 0.5 * math.pi:
            break
        state = plant.step(state, VehicleCommand(0.0, 2.0 * (1.0 - v) + 0.06, (), -1.0), HELD)
    way, gamma = np.array(seen).T
    expected = 2.0 * np.arctan(math.tan(0.5 * start) * np.exp(way / length))
    assert gamma[-1] >= 0.5 * math.pi  # jackknifed, nobody steered
    np.testing.assert_allclose(gamma, expected, rtol=0.01)  # slip of 1e-3 on the way


@pytest.mark.parametrize("gear", [0.0, 2.0])
def test_there_are_two_gears(tractor_semitrailer: Vehicle, gear: float) -> None:
    plant, batch = Plant(tractor_semitrailer, DRY), PlantBatch(tractor_semitrailer, 1, "interpreted")
    with pytest.raises(ValueError, match=r"gear.*must be 1 \(forward\) or -1 \(backward\)"):
        plant.step(plant.initial_state(ORIGIN, 0.0), VehicleCommand(0.0, 0.0, (), gear), 1)
    with pytest.raises(ValueError, match=r"gear.*must be 1 \(forward\) or -1 \(backward\)"):
        batch.step(0.0, 0.0, np.zeros((1, 0)), 1, gear)
