"""Whatever the catalogue offers by name can be had by that name, and runs."""

import numpy as np
import pytest

from scenarios import catalogue
from scenarios.catalogue import DRIVER, ROVER_DRIVER, Catalogue, resolve
from scenarios.loop.runner import KINDS
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.options.shipped import scenario_names
from vehicle.combination.description import load_vehicle, vehicle_names
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.rover.description import rover_names, soil_names
from vehicle.surface import Surface

CATALOGUES = {key: names for key, names in vars(catalogue).items() if isinstance(names, Catalogue)}
SCENARIOS = {name: load_any_scenario(name) for name in scenario_names()}
TRAILERS = sorted(name for name, scenario in SCENARIOS.items() if isinstance(scenario, Scenario))
ROVERS = sorted(set(SCENARIOS) - set(TRAILERS))
DRIVERS = [f"roundabout driver.kind={name}" for name in DRIVER if name != "recorded"]  # that one needs a file
ROVER_PARTS = [
    *(f"rover-slope driver={name}" for name in ROVER_DRIVER),
    *(f"rover-slope vehicle={name} slip_compensation=none" for name in rover_names()),
    *(f"rover-slope surface.soil={name}" for name in soil_names()),
]


@pytest.mark.parametrize(("key", "name"), [(key, name) for key, names in CATALOGUES.items() for name in names])
def test_every_entry_names_a_class_with_the_methods_of_its_kind(key: str, name: str) -> None:
    """The catalogue holds import paths, so a wrong one would only show when someone asks for it."""
    assert isinstance(resolve(key, name, CATALOGUES[key]), type)


SLOW = [pytest.param(case, marks=pytest.mark.slow) for case in (*TRAILERS, *DRIVERS, *ROVER_PARTS)]


@pytest.mark.parametrize("case", [*ROVERS, *SLOW])
def test_every_scenario_is_named_after_its_file_and_starts_with_every_driver_and_part(case: str) -> None:
    """Two seconds with exact estimates: finite signals, trailers at set speed; rovers lose a tenth or two to slip."""
    name, *settings = case.split()
    exact = "slip_estimator=truth" if name in ROVERS else "off_tracking=truth"
    scenario = load_any_scenario(name, [exact, *settings])
    assert scenario.name == name
    assert scenario.description
    kind = KINDS[scenario.vehicle_kind]
    with kind.session(kind.assemble(scenario, 1)) as session:
        while session.tick < 2000:
            session.advance()
    truth = session.rows[-1].truth
    if isinstance(scenario, Scenario):
        assert np.isfinite(truth.bodies).all()
        assert truth.velocities[0, 0] == pytest.approx(scenario.speed, rel=0.05)  # a grade costs until it is held
    else:
        assert np.isfinite(truth.X_WB).all()
        assert 0.5 * scenario.speed < truth.velocity[0] < 1.05 * scenario.speed
    assert session.outcome is None


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.1, 0.8])
@pytest.mark.parametrize("name", vehicle_names())  # of one vehicle after the other, for what is built for each
def test_every_vehicle_turns_without_losing_its_footing_in_numbers(name: str, friction: float) -> None:
    """Full lock at 30 km/h, on ice and on a dry road: it may slide, but states stay finite and loads add up."""
    vehicle = load_vehicle(name)
    plant = Plant(vehicle, Surface(friction=friction))
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), 30.0 / 3.6)
    steered = vehicle.n_by_law
    for k in range(300):
        state = plant.step(state, VehicleCommand(0.4, 0.0, (0.1,) * steered), 10)
        truth = plant.observe(state, 10 * (k + 1))
        assert np.isfinite(truth.bodies).all()
        assert truth.friction_used.max() <= 1.0 + 1e-6  # rounding; the bristle law keeps to the friction circle
    assert truth.wheel_loads.sum() == pytest.approx(9.81 * vehicle.mass, rel=0.02)  # lifted wheels carry a little
