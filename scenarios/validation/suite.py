"""All sections of the validation, in the order of the page."""

from __future__ import annotations

from typing import Final

from scenarios.validation.amplification import rearward_amplification
from scenarios.validation.braking import braking
from scenarios.validation.check import Task
from scenarios.validation.design_vehicles import design_vehicles
from scenarios.validation.driver_checks import driver
from scenarios.validation.integration import integration
from scenarios.validation.linear_theory import linear_theory
from scenarios.validation.mechanics import mechanics
from scenarios.validation.multibody_check import multibody_check
from scenarios.validation.no_slip_limit import no_slip_limit
from scenarios.validation.parking import parking
from scenarios.validation.rollover import rollover
from scenarios.validation.roundabout import roundabout
from scenarios.validation.steady_turns import steady_turns
from scenarios.validation.tractrix import tractrix
from scenarios.validation.tyre_lag import tyre_lag

TASKS: Final = (
    Task(title="Design vehicles", work=design_vehicles),
    Task(title="Tractrix", work=tractrix),
    Task(title="Steady turns", work=steady_turns),
    Task(title="Roundabout", work=roundabout),
    Task(title="Kinematic limit", work=no_slip_limit),
    Task(title="Linear theory", work=linear_theory),
    Task(title="Rearward amplification", work=rearward_amplification),
    Task(title="Multibody model", work=multibody_check),
    Task(title="Rollover", work=rollover),
    Task(title="Tyre lag", work=tyre_lag),
    Task(title="Parking", work=parking),
    Task(title="Driver", work=driver),
    Task(title="Brakes and drive", work=braking),
    Task(title="Mechanics", work=mechanics),
    Task(title="Integrator", work=integration),
)
