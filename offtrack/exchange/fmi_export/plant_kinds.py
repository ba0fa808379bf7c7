"""Combinations and rovers as models to export, by name: inputs, outputs, parameters and programs.

Names are those of ``fmi_import.plant`` where both mean the same, so that an exported plant needs no map there.
"""

from collections.abc import Sequence
from typing import Any, Final

import casadi as ca
import numpy as np

from offtrack.exchange.fmi_export.plant_model import (
    PlantModel,
    fixed_values,
    interface_of,
    number_signal,
    start_signals,
    vector,
)
from offtrack.exchange.fmi_import.mapping import Signal, numbered
from offtrack.exchange.fmi_import.numbered_signals import ground_signals, kind_of, motion_signals
from offtrack.reports.vehicle_sheet.combination_sheet import is_rover
from vehicle.clock import TICK
from vehicle.combination import functions, layout
from vehicle.combination.chain import Kinematics, WheelTruth, kinematics_sizes, smooth_ground_sizes, wheel_truth_sizes
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.engine.program import TapeProgram, program_of
from vehicle.rover.description import Rover, Soil, load_rover, load_soil
from vehicle.rover.equations import RoverInput, RoverState, input_sizes, lift_function, load_function, numbers
from vehicle.rover.equations import state_sizes as rover_state_sizes
from vehicle.rover.equations import step_function as rover_step_function
from vehicle.rover.plant import LONGEST_STEP

_FRICTIONS: Final = {"friction_wheel": 0.8}  # of dry asphalt, where nothing is connected [-]


def combination_model(vehicle: Vehicle) -> PlantModel:
    """The model of a vehicle; one ``in_wind`` has inputs for the wind."""
    vehicle = vehicle.with_torque_inputs()
    twin = functions.symbolic_twin(vehicle)
    paths = [str(twin.symbols[k]) for k in range(twin.symbols.numel())]
    parameters = [number_signal(vehicle, path, value) for path, value in zip(paths, twin.values.tolist(), strict=True)]
    inputs, outputs = combination_inputs(vehicle), motion_signals(vehicle)
    observe = _observe_combination(vehicle, len(inputs), twin.symbols.numel())
    programs = {
        "step": program_of(functions.timed_step_function(vehicle)),
        "observe": program_of(observe),
        "start": program_of(functions.start_function(vehicle)),
    }
    interface = interface_of(parameters, start_signals("the tractor's frame"), inputs, outputs, observe, programs)
    unread = [signal for k, signal in enumerate(parameters) if k in interface.fixed]
    return PlantModel(
        name=vehicle.name,
        summary=vehicle.summary,
        kind="combination",
        interface=interface,
        programs=programs,
        defined={
            "FIRST_START": len(parameters),
            "FIRST_GROUND": sum(layout.command_sizes(vehicle)),
            "FIRST_FRICTION": sum(layout.command_sizes(vehicle)),
            "N_FRICTIONS": vehicle.n_wheels,
            "LONGEST_STEP": 1,
        },
        gear=layout.CommandInputs(*layout.slices(layout.command_sizes(vehicle))).gear.start,
        fixed=fixed_values(vehicle, unread),
        stepping=f"A communication step is divided into equal steps of at most {1e3 * TICK:g} ms.",
    )


def combination_inputs(vehicle: Vehicle) -> list[Signal]:
    """Inputs in the order of ``CommandInputs`` and ``GroundInputs``, then heights and slopes below the bodies."""
    axles = [
        (unit.name, k)
        for unit in vehicle.units
        for k, axle in enumerate(unit.steered_axles, start=1)
        if axle.steered_by_law or unit is not vehicle.units[0]
    ]
    axle_names = [f"axle {k} of {unit.name}" for unit in vehicle.units for k, _ in enumerate(unit.axles, start=1)]
    return [
        Signal("steer", "rad", "demanded road-wheel angle of the tractor's foremost steered axle, + left"),
        Signal("acceleration", "m/s2", "demanded: above 0 drives the way the gear does, below 0 brakes"),
        *numbered("steer_trailer", "rad", [f"demanded angle of steered axle {k} of {name}" for name, k in axles]),
        Signal("gear", "-", "1 forward, -1 backward; change it at a standstill; 0: as at the start", 1.0),
        *numbered("drive_torque", "N m", [f"of a further drive on {axle}, + forward" for axle in axle_names]),
        *numbered("brake_torque", "N m", [f"of a further brake on {axle}, not below 0" for axle in axle_names]),
        *(one._replace(start=_FRICTIONS.get(kind_of(one), 0.0)) for one in ground_signals(vehicle)),
    ]


def _observe_combination(vehicle: Vehicle, n_inputs: int, n_numbers: int) -> Any:
    """Function (state, inputs, numbers) -> outputs, in the order of ``motion_signals``."""
    N, sizes = len(vehicle.units), (*layout.command_sizes(vehicle), *layout.ground_input_sizes(vehicle))
    x, u, numbers = vector(sum(layout.state_sizes(vehicle))), vector(n_inputs), vector(n_numbers)
    n_heights = smooth_ground_sizes(vehicle).height
    plant_inputs, heights, *more = layout.parts(u, (sum(sizes), n_heights, N, N))
    of_ground = layout.GroundInputs(*layout.parts(plant_inputs, sizes)[len(layout.command_sizes(vehicle)) :])
    slopes = [at_centre + less for at_centre, less in zip((of_ground.slope_x, of_ground.slope_y), more, strict=True)]
    smooth = ca.vertcat(heights, *(slope[k // 2] for slope in slopes for k in range(2 * N)))
    state = layout.State(*layout.parts(x, layout.state_sizes(vehicle)))
    motion = Kinematics(
        *layout.parts(functions.kinematics_function(vehicle)(x, ca.SX(0, 1), numbers), kinematics_sizes(vehicle))
    )
    idle = ca.vertcat(ca.SX.zeros(sum(layout.command_sizes(vehicle))), *of_ground)
    of_wheels = WheelTruth(
        *layout.parts(functions.wheel_function(vehicle)(x, idle, numbers), wheel_truth_sizes(vehicle))
    )
    bodies, headings = functions.body_function(vehicle)(x, smooth, numbers), motion.poses[2::3]
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


_SOIL_FRICTION: Final = 0.6  # of a lugged wheel on firm ground, as of ``Terrain`` [-]
_AT_REST: Final = 1e-6  # as of ``posture``: below it a velocity has no direction [m/s]


def rover_model(rover: Rover, soil: Soil | None) -> PlantModel:
    """The model of a rover in a soil or (None) on firm ground."""
    parameters = _parameters(rover, soil)
    names, n = [signal.name for signal in parameters], len(rover.wheels)
    inputs, outputs = rover_inputs(rover), rover_outputs(rover)
    observe = _observe_rover(rover, soil, len(inputs), len(parameters), names.index("radius"))
    programs: dict[str, TapeProgram] = {
        "step": program_of(rover_step_function(rover, soil)),
        "observe": program_of(observe),
        "loads": program_of(load_function(rover, soil)),
    }
    if soil is not None:
        programs["lift"] = program_of(lift_function(rover, soil))
    interface = interface_of(parameters, start_signals("the body's centre"), inputs, outputs, observe, programs)
    unread = [signal for k, signal in enumerate(parameters) if k in interface.fixed]
    in_state, in_input = RoverState(*layout.slices(rover_state_sizes(n))), RoverInput(*layout.slices(input_sizes(n)))
    return PlantModel(
        name=rover.name if soil is None else f"{rover.name}_{soil.name}",
        summary=rover.summary if soil is None else f"{rover.summary}; in {soil.name}",
        kind="rover",
        interface=interface,
        programs=programs,
        defined={
            "FIRST_START": len(parameters),
            "N_WHEELS": n,
            "RADIUS": names.index("radius"),
            "OMEGA": in_state.wheel_speed.start,
            "TURN": in_state.turn.start,
            "SINKAGE": in_state.sinkage.start,
            "LONGEST_STEP": LONGEST_STEP,
            "FIRST_FIRM": in_input.firm.start - 1,  # the length of a step is no input of the FMU
        },
        gear=None,
        stepping=f"A communication step is divided into equal steps of at most {1e3 * LONGEST_STEP * TICK:g} ms.",
        fixed=[
            *fixed_values(rover, unread),
            *((f"wheels.{k}.{axis}", f"{getattr(wheel, axis):g}, in proportion to {size}")
              for k, wheel in enumerate(rover.wheels)
              for axis, size in (("x", "wheels.half_length"), ("y", "wheels.half_width"))),
            *([] if soil is None else [(f"soil.{path}", value) for path, value in fixed_values(soil, [])]),
        ],
    )  # fmt: skip


def rover_inputs(rover: Rover) -> list[Signal]:
    """Inputs in the order of ``RoverInput``, then heights of the ground under the wheels."""
    wheels = [wheel.name for wheel in rover.wheels]
    return [
        *numbered("wheel_speed_demand", "rad/s", [f"demanded rotation of {name}, + forward" for name in wheels]),
        *numbered(
            "steer_demand",
            "rad",
            [f"demanded angle of {wheel.name}, + left" + ("" if wheel.steered else ": not steered, no effect")
             for wheel in rover.wheels],
        ),
        *numbered("ground_slope_x", "-", [f"rise of the ground under {name} along x of the world" for name in wheels]),
        *numbered("ground_slope_y", "-", [f"rise of the ground under {name} along y of the world" for name in wheels]),
        *numbered("firm", "-", [f"1 where the ground under {name} is firm, else 0" for name in wheels]),
        Signal("friction", "-", "friction coefficient of firm ground", _SOIL_FRICTION),
        *numbered("ground_height", "m", [f"height of the ground at {name}: lifts the body" for name in wheels]),
    ]  # fmt: skip


def rover_outputs(rover: Rover) -> list[Signal]:
    """Outputs: everything that ``RoverTruth`` has, the body's pose as position and angles."""
    wheels = [wheel.name for wheel in rover.wheels]
    return [
        Signal("x", "m", "position of the body's centre in the world"),
        Signal("y", "m", "position of the body's centre in the world"),
        Signal("psi", "rad", "heading, + left, continuous"),
        Signal("v_x", "m/s", "velocity of the body's centre along the body"),
        Signal("v_y", "m/s", "velocity of the body's centre across the body, + left"),
        Signal("yaw_rate", "rad/s", "about the ground's normal"),
        *(Signal(f"body_{axis}", "m", "origin of the body in the world, sinkage included") for axis in "xyz"),
        Signal("body_roll", "rad", "of the body about its x axis, third"),
        Signal("body_pitch", "rad", "of the body about the y axis, second, + nose down"),
        Signal("body_yaw", "rad", "of the body about the z axis, first; -pi to pi"),
        *(
            signal
            for axis in "xyz"
            for signal in numbered(f"wheel_{axis}", "m", [f"lowest point of {name} in the world" for name in wheels])
        ),
        *numbered("wheel_heading", "rad", [f"direction of {name} in the world" for name in wheels]),
        *numbered("wheel_v_along", "m/s", [f"velocity of the centre of {name} along its heading" for name in wheels]),
        *numbered("wheel_v_across", "m/s", [f"velocity of the centre of {name} across it, + left" for name in wheels]),
        *numbered("wheel_speed", "rad/s", [f"speed of rotation of {name}, + forward" for name in wheels]),
        *numbered("wheel_turn", "rad", [f"angle that {name} has rolled since the start" for name in wheels]),
        *numbered("steer_angle", "rad", [f"of {name} against the body, + left" for name in wheels]),
        *numbered("slip_ratio", "-", [f"of {name}: (r omega - v_x) over r omega or, braking, v_x" for name in wheels]),
        *numbered("slip_angle", "rad", [f"direction of travel of {name} to its heading, + left" for name in wheels]),
        *numbered("sinkage", "m", [f"of {name}" for name in wheels]),
        *numbered("wheel_load", "N", [f"force on {name} normal to the ground" for name in wheels]),
    ]  # fmt: skip


def _parameters(rover: Rover, soil: Soil | None) -> list[Signal]:
    """Numbers in the order of ``equations.numbers``."""
    found = [number_signal(rover, key, value) for key, value in rover if isinstance(value, float)]
    if soil is not None:
        found += [number_signal(soil, key, value, "soil.") for key, value in soil if isinstance(value, float)]
    length, width = (float(size) for size in rover.footprint[:2])
    found.append(Signal("wheels.half_length", "m", "x of the foremost wheels; the others in proportion", length))
    found.append(Signal("wheels.half_width", "m", "y of the outermost left wheels; the others in proportion", width))
    assert np.array_equal([signal.start for signal in found], numbers(rover, soil))
    return found


def _observe_rover(rover: Rover, soil: Soil | None, n_inputs: int, n_numbers: int, radius: int) -> Any:
    """Function (state, inputs, numbers) -> outputs, in the order of ``rover_outputs``."""
    n = len(rover.wheels)
    x, u, p = vector(sum(rover_state_sizes(n))), vector(n_inputs), vector(n_numbers)
    s = RoverState(*layout.parts(x, rover_state_sizes(n)))
    heights = u[n_inputs - n :]
    idle = ca.vertcat(ca.SX.zeros(2 * n), 1.0, u[2 * n : n_inputs - n])
    along, across = (ca.DM(share) for share in (rover.footprint.along, rover.footprint.across))
    places = ca.horzcat(p[n_numbers - 2] * along, p[n_numbers - 1] * across)
    R, origin, wheels = _posture(places, (rover.footprint.along, rover.footprint.across), s, heights)
    v_x, v_y = s.v_x - s.yaw_rate * places[:, 1], s.v_y + s.yaw_rate * places[:, 0]
    c, d = ca.cos(s.steer), ca.sin(s.steer)
    v_along, v_across = v_x * c + v_y * d, v_y * c - v_x * d
    roll, pitch = ca.atan2(R[2, 1], R[2, 2]), ca.atan2(-R[2, 0], ca.sqrt(R[2, 1] ** 2 + R[2, 2] ** 2))
    values = [
        *(s.x, s.y, s.psi, s.v_x, s.v_y, s.yaw_rate),
        *(origin, roll, pitch, ca.atan2(R[1, 0], R[0, 0])),
        *(wheels[:, k] for k in range(3)),
        *(s.psi + s.steer, v_along, v_across, s.wheel_speed, s.turn, s.steer),
        *(_slip_ratios(p[radius] * s.wheel_speed, v_along), _slip_angles(v_along, v_across)),
        *(s.sinkage, load_function(rover, soil)(x, idle, p)),
    ]
    return ca.Function("observe", [x, u, p], [ca.cse(ca.densify(ca.vertcat(*values)))])


def _posture(
    places: ca.SX, weights: Sequence[Sequence[float]], s: RoverState[ca.SX], heights: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """R_WB of the body, its origin and the wheels' lowest points (n, 3) in W [m], as ``Undercarriage.posture``."""
    c, d = ca.cos(s.psi), ca.sin(s.psi)
    z, n = heights - s.sinkage, heights.numel()
    shift = ca.horzcat(ca.repmat(s.x, n, 1), ca.repmat(s.y, n, 1))
    flat = ca.horzcat(places[:, 0] * c - places[:, 1] * d, places[:, 0] * d + places[:, 1] * c) + shift
    R, origin = ca.SX.eye(3), ca.SX.zeros(3)
    for _ in range(2):
        lowest = ca.horzcat(flat, z)
        forward, leftward = (ca.DM(list(share)).T @ lowest for share in weights)
        e_x = forward.T / ca.norm_2(forward)
        up = ca.cross(e_x, leftward.T)
        e_z = up / ca.norm_2(up)
        R = ca.horzcat(e_x, ca.cross(e_z, e_x), e_z)
        flat = places @ R[:2, :2].T + shift
        origin = ca.sum1(lowest).T / n
    return R, origin, ca.horzcat(flat, z)


def _slip_ratios(rim: ca.SX, v_x: ca.SX) -> ca.SX:
    """``posture.slip_ratios``."""
    over = ca.if_else(rim * (rim - v_x) > 0.0, rim, v_x)
    at_rest = ca.fabs(over) <= _AT_REST
    return ca.if_else(at_rest, 0.0, (rim - v_x) / ca.if_else(at_rest, 1.0, over))


def _slip_angles(v_along: ca.SX, v_across: ca.SX) -> ca.SX:
    """``posture.slip_angles``."""
    speed = ca.sqrt(v_along**2 + v_across**2)
    return ca.if_else(speed > _AT_REST, ca.atan2(v_across, v_along), 0.0)


def plant_model(name_or_path: str, soil: str | None, *, wind: bool) -> PlantModel:
    """The model of a shipped vehicle or rover, or of one from a TOML file.

    Raises:
        ValueError: one line, if the file is wrong, or an option is not for its kind.
    """
    if is_rover(name_or_path):
        if wind:
            raise ValueError(f"--wind: rover {name_or_path} has no inputs for the wind")
        return rover_model(load_rover(name_or_path), None if soil is None else load_soil(soil))
    if soil is not None:
        raise ValueError(f"--soil {soil}: {name_or_path} is no rover; trucks drive on roads")
    vehicle = load_vehicle(name_or_path)
    return combination_model(vehicle.in_wind() if wind else vehicle)
