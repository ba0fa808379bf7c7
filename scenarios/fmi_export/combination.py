"""A combination as a model: its inputs, outputs and parameters, and the programs behind them.

Names are those of ``fmi_import.plant`` where both mean the same, so that an exported plant needs no map there.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from scenarios.fmi_export.model import (
    PlantModel,
    fixed_values,
    interface_of,
    number_quantity,
    start_quantities,
    vector,
)
from scenarios.fmi_export.variables import Quantity, numbered
from vehicle.clock import TICK
from vehicle.combination.attitude import smooth_ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import (
    body_function,
    kinematics_function,
    start_function,
    step_function,
    wheel_function,
)
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant_inputs import CommandInputs, GroundInputs, command_sizes, ground_input_sizes, slices
from vehicle.combination.symbolic import symbolic_twin
from vehicle.combination.truth_vectors import Kinematics, WheelTruth, kinematics_sizes, wheel_truth_sizes
from vehicle.engine.program import program_of

_FRICTION = 0.8  # of dry asphalt, where nothing is connected [-]
_BODY_SLOPE = "on curved ground: mean rise at the supports of {} less that under its centre of gravity: tilts its body"


def combination_model(vehicle: Vehicle) -> PlantModel:
    """The model of a vehicle; one ``in_wind`` has inputs for the wind."""
    vehicle = vehicle.with_torque_inputs()
    twin = symbolic_twin(vehicle)
    paths = [str(twin.symbols[k]) for k in range(twin.symbols.numel())]
    parameters = [
        number_quantity(vehicle, path, value) for path, value in zip(paths, twin.values.tolist(), strict=True)
    ]
    inputs, outputs = combination_inputs(vehicle), combination_outputs(vehicle)
    observe = _observe_function(vehicle, len(inputs), twin.symbols.numel())
    programs = {
        "step": program_of(step_function(vehicle)),
        "observe": program_of(observe),
        "start": program_of(start_function(vehicle)),
    }
    interface = interface_of(parameters, start_quantities("the tractor's frame"), inputs, outputs, observe, programs)
    unread = [quantity for k, quantity in enumerate(parameters) if k in interface.fixed]
    return PlantModel(
        name=vehicle.name,
        summary=vehicle.summary,
        kind="combination",
        interface=interface,
        programs=programs,
        defined={
            "FIRST_START": len(parameters),
            "FIRST_GROUND": sum(command_sizes(vehicle)),
            "FIRST_FRICTION": sum(command_sizes(vehicle)),
            "N_FRICTIONS": vehicle.n_wheels,
        },
        gear=CommandInputs(*slices(command_sizes(vehicle))).gear.start,
        fixed=fixed_values(vehicle, unread),
        internal_step=TICK,
        stepping=f"Internal step: {1e3 * TICK:g} ms.",
    )


def combination_inputs(vehicle: Vehicle) -> list[Quantity]:
    """Inputs in the order of ``CommandInputs`` and ``GroundInputs``, then heights and slopes below the bodies."""
    units = [unit.name for unit in vehicle.units]
    axles = [(unit.name, k) for unit in vehicle.units[1:] for k, _ in enumerate(unit.steered_axles, start=1)]
    axle_names = [f"axle {k} of {unit.name}" for unit in vehicle.units for k, _ in enumerate(unit.axles, start=1)]
    tyres = _wheel_names(vehicle)
    inputs = [
        Quantity("steer", "rad", "demanded road-wheel angle of the tractor's foremost steered axle, + left"),
        Quantity("acceleration", "m/s2", "demanded: above 0 drives the way the gear does, below 0 brakes"),
        *numbered("steer_trailer", "rad", [f"demanded angle of steered axle {k} of {name}" for name, k in axles]),
        Quantity("gear", "-", "1 forward, -1 backward; change it at a standstill; 0: as at the start", 1.0),
        *numbered("drive_torque", "N m", [f"of a further drive on {axle}, + forward" for axle in axle_names]),
        *numbered("brake_torque", "N m", [f"of a further brake on {axle}, not below 0" for axle in axle_names]),
        *numbered(
            "friction_wheel",
            "-",
            [f"friction coefficient under {tyre}; 0: as at the start" for tyre in tyres],
            _FRICTION,
        ),
        *numbered("ground_slope_x", "-", [f"rise of the ground under {name} along x of the world" for name in units]),
        *numbered("ground_slope_y", "-", [f"rise of the ground under {name} along y of the world" for name in units]),
        *numbered("road_height", "m", [f"height of the road under {tyre} above the smooth one" for tyre in tyres]),
        *numbered("wind", "m/s", [f"wind at {name} along y of the world" for name in units if vehicle.exposed]),
    ]  # fmt: skip
    supports = [f"{end} support of {name}" for name in units for end in ("front", "rear")]
    return [
        *inputs,
        *numbered(
            "ground_height", "m", [f"height of the smooth ground at the {at}: lifts its body" for at in supports]
        ),
        *numbered("body_slope_x", "-", [f"{_BODY_SLOPE.format(name)} along x of the world" for name in units]),
        *numbered("body_slope_y", "-", [f"{_BODY_SLOPE.format(name)} along y of the world" for name in units]),
    ]


def combination_outputs(vehicle: Vehicle) -> list[Quantity]:
    """Outputs: everything that ``Truth`` has, a body's pose as position and angles; units count from 1, the tractor."""
    units, tyres = [unit.name for unit in vehicle.units], _wheel_names(vehicle)
    axles = [(unit.name, k) for unit in vehicle.units for k, _ in enumerate(unit.steered_axles, start=1)]
    return [
        *numbered("x", "m", [f"position of the frame of {name} in the world" for name in units]),
        *numbered("y", "m", [f"position of the frame of {name} in the world" for name in units]),
        *numbered("psi", "rad", [f"heading of {name}, + left, continuous" for name in units]),
        *numbered("v_x", "m/s", [f"velocity of that point along the x axis of {name}" for name in units]),
        *numbered("v_y", "m/s", [f"velocity of that point along the y axis of {name}" for name in units]),
        *numbered("yaw_rate", "rad/s", [f"of {name}" for name in units]),
        *numbered("heave", "m", [f"of the body of {name} above the ground's height, + up" for name in units]),
        *numbered("pitch", "rad", [f"of the body of {name} against the ground, + nose down" for name in units]),
        *numbered("roll", "rad", [f"of the body of {name} against the ground, + left side up" for name in units]),
        *(
            quantity
            for k, name in enumerate(units, start=1)
            for quantity in (
                *(Quantity(f"body_{axis}_{k}", "m", f"origin of the body of {name} in the world") for axis in "xyz"),
                Quantity(f"body_roll_{k}", "rad", f"of the body of {name}, about its x axis, third"),
                Quantity(f"body_pitch_{k}", "rad", f"of the body of {name}, about the y axis, second, + nose down"),
                Quantity(f"body_yaw_{k}", "rad", f"of the body of {name}, about the z axis, first; -pi to pi"),
            )
        ),
        *numbered("steer_angle", "rad", [f"angle of steered axle {k} of {name}, + left" for name, k in axles]),
        *numbered("wheel_load", "N", [f"vertical force of {tyre}" for tyre in tyres]),
        *numbered("wheel_slip_angle", "rad", [f"of {tyre}" for tyre in tyres]),
        *numbered("friction_used", "-", [f"horizontal force of {tyre} over friction times load" for tyre in tyres]),
        *numbered("load_transfer", "-", [f"of {name}: right less left wheel loads over all" for name in units]),
        *numbered("articulation", "rad", [f"heading of {name} less that of the next unit" for name in units[:-1]]),
    ]  # fmt: skip


def _wheel_names(vehicle: Vehicle) -> list[str]:
    return [
        f"the {'left' if wheel.side > 0 else 'right'} wheel of axle {wheel.axle_in_unit + 1} of "
        f"{vehicle.units[wheel.unit].name}"
        for wheel in wheels(vehicle)
    ]


def _observe_function(vehicle: Vehicle, n_inputs: int, n_numbers: int) -> Any:
    """Function (state, inputs, numbers) -> outputs, in the order of ``combination_outputs``."""
    N, sizes = len(vehicle.units), (*command_sizes(vehicle), *ground_input_sizes(vehicle))
    x, u, numbers = vector(sum(state_sizes(vehicle))), vector(n_inputs), vector(n_numbers)
    n_heights = smooth_ground_sizes(vehicle).height
    plant_inputs, heights, *more = parts(u, (sum(sizes), n_heights, N, N))
    of_ground = GroundInputs(*parts(plant_inputs, sizes)[len(command_sizes(vehicle)) :])
    slopes = [at_centre + less for at_centre, less in zip((of_ground.slope_x, of_ground.slope_y), more, strict=True)]
    smooth = ca.vertcat(heights, *(slope[k // 2] for slope in slopes for k in range(2 * N)))
    state = State(*parts(x, state_sizes(vehicle)))
    motion = Kinematics(*parts(kinematics_function(vehicle)(x, ca.SX(0, 1), numbers), kinematics_sizes(vehicle)))
    idle = ca.vertcat(ca.SX.zeros(sum(command_sizes(vehicle))), *of_ground)
    of_wheels = WheelTruth(*parts(wheel_function(vehicle)(x, idle, numbers), wheel_truth_sizes(vehicle)))
    bodies, headings = body_function(vehicle)(x, smooth, numbers), motion.poses[2::3]
    values = [
        *(motion.poses[k::3] for k in range(3)),
        *(motion.velocities[k::3] for k in range(3)),
        *(state.heave, state.pitch, state.roll),
        *(_pose(bodies[16 * k : 16 * k + 16]) for k in range(N)),
        *of_wheels,
        *([headings[:-1] - headings[1:]] if N > 1 else []),
    ]
    return ca.Function("observe", [x, u, numbers], [ca.cse(ca.densify(ca.vertcat(*values)))])


def _pose(X: ca.SX) -> ca.SX:
    """Position, roll, pitch and yaw of a pose given row by row."""
    roll, pitch = ca.atan2(X[9], X[10]), ca.atan2(-X[8], ca.sqrt(X[9] ** 2 + X[10] ** 2))
    return ca.vertcat(X[3], X[7], X[11], roll, pitch, ca.atan2(X[4], X[0]))
