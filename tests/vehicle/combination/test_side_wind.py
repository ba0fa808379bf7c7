"""Side wind on the bodies: force, moments, and nothing without a gust."""

import math

import numpy as np
import pytest

from tests.vehicle.chains import at_rest, rates
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import step_function
from vehicle.combination.layout import State, input_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.roll import springs_of
from vehicle.engine.function_cache import written_out
from vehicle.frames import Pose2
from vehicle.surface import Gust, Surface

ORIGIN = Pose2(0.0, 0.0, 0.0)


def accelerations(vehicle: Vehicle, speed: float, wind: float) -> State[np.ndarray]:
    """Rates of a vehicle whose tyres are not yet deflected, heading along W's x."""
    s, u = at_rest(vehicle, wind=np.full(len(vehicle.units), wind), gear=np.ones(1))
    omega = [speed / axle.wheel_radius for unit in vehicle.units for axle in unit.axles for _ in (0, 1)]
    return rates(vehicle, s._replace(v_x=np.array([speed]), omega=np.array(omega)), u)


def without_data(vehicle: Vehicle) -> Vehicle:
    units = tuple(unit.model_copy(update={"side_wind": None}) for unit in vehicle.units)
    return vehicle.model_copy(update={"units": units})


def test_a_truck_is_pushed_turned_and_rolled() -> None:
    """F = rho / 2 A c V w: acceleration F / m, yaw F (x_p - x_cg) / I, roll -F (h_p - h_cg) / I about the roll axis.

    A root that is kept from zero takes 1e-9 of the force.
    """
    truck = load_vehicle("rigid_truck").in_wind()
    (unit,) = truck.units
    body = unit.side_wind
    assert body is not None
    speed, wind = 20.0, 8.0
    calm, rate = accelerations(truck, speed, 0.0), accelerations(truck, speed, wind)
    F = 0.6 * body.area * body.coefficient * math.hypot(speed, wind) * wind
    yaw = F * (body.x - unit.cg_x) / unit.yaw_inertia
    assert rate.yaw_rate[0] - calm.yaw_rate[0] == pytest.approx(yaw, rel=1e-7)
    assert rate.v_y[0] - calm.v_y[0] == pytest.approx(
        F / unit.mass - unit.cg_x * yaw, rel=1e-7
    )  # a root kept from zero
    rolled = -F * (body.height - unit.cg_height) / float(springs_of(truck)[0].inertia)
    assert rate.roll_spring[0] - calm.roll_spring[0] == pytest.approx(rolled, rel=1e-6)


def test_the_trailer_s_wind_reaches_the_tractor_through_the_hitch(tractor_semitrailer: Vehicle) -> None:
    """Momentum of the whole: the masses' accelerations add up to all side forces."""
    vehicle = tractor_semitrailer.in_wind()
    calm, rate = accelerations(vehicle, 20.0, 0.0), accelerations(vehicle, 20.0, 8.0)
    tractor, trailer = vehicle.units
    a, r = float(rate.v_y[0] - calm.v_y[0]), rate.yaw_rate - calm.yaw_rate
    hitch = a + tractor.rear_hitch[0] * r[0]
    pushed = tractor.mass * (a + tractor.cg_x * r[0]) + trailer.mass * (hitch + trailer.cg_x * r[1])
    areas = sum(unit.side_wind.area * unit.side_wind.coefficient for unit in vehicle.units if unit.side_wind)
    assert pushed == pytest.approx(0.6 * areas * math.hypot(20.0, 8.0) * 8.0, rel=1e-7)


@pytest.mark.slow
def test_a_gust_moves_the_vehicle_to_leeward(tractor_semitrailer: Vehicle) -> None:
    """From the right at 20 m/s over 30 m of the road: it leans and drifts to the left, and nothing before the gust."""
    gust = Gust(speed=20.0, start=30.0, length=30.0)
    plant = Plant(tractor_semitrailer, Surface(friction=0.8, gust=gust))
    state = plant.initial_state(ORIGIN, 22.0)
    before = plant.step(state, VehicleCommand(0.0, 0.0, ()), 900)
    assert plant.observe(before, 900).poses[0, 1] == pytest.approx(0.0, abs=1e-9)
    after = plant.observe(plant.step(before, VehicleCommand(0.0, 0.0, ()), 2000), 2900)
    assert 0.05 < after.poses[0, 1] < 3.0
    opposite = Surface(friction=0.8, gust=Gust(speed=-20.0, start=30.0, length=30.0))
    mirrored = Plant(tractor_semitrailer, opposite)
    other = mirrored.step(mirrored.initial_state(ORIGIN, 22.0), VehicleCommand(0.0, 0.0, ()), 2900)
    assert mirrored.observe(other, 2900).poses[0, 1] == pytest.approx(-after.poses[0, 1], rel=1e-6)


def test_without_a_gust_nothing_of_the_wind_is_computed(tractor_semitrailer: Vehicle) -> None:
    """The same compiled step with and without the data; no inputs."""
    bare = without_data(tractor_semitrailer)
    assert input_sizes(tractor_semitrailer).wind == 0
    assert input_sizes(bare) == input_sizes(tractor_semitrailer)
    lengths = [written_out(step_function(v)).n_instructions() for v in (bare, tractor_semitrailer)]
    assert lengths[1] - lengths[0] <= 8  # the numbers are entries of the function that nothing reads


def test_a_gust_needs_data(short_form: Vehicle, tractor_semitrailer: Vehicle) -> None:
    for vehicle, says in (
        (without_data(tractor_semitrailer), "a gust needs the table 'side_wind' of a unit"),
        (short_form, "a gust needs the tables 'suspension' and 'roll'"),
    ):
        with pytest.raises(ValueError, match=f"^eu_tractor_semitrailer: {says}$"):
            Plant(vehicle, Surface(friction=0.8, gust=Gust(speed=10.0, start=0.0, length=10.0)))
