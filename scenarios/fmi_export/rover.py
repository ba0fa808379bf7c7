"""A rover as a model: its inputs, outputs and parameters, and the programs behind them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import casadi as ca
import numpy as np

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
from vehicle.combination.layout import parts
from vehicle.combination.plant_inputs import slices
from vehicle.engine.program import Program, program_of
from vehicle.rover.description import Rover
from vehicle.rover.equations import lift_function, load_function, numbers, step_function
from vehicle.rover.layout import RoverInput, RoverState, input_sizes, state_sizes
from vehicle.rover.plant import LONGEST_STEP
from vehicle.rover.soil import Soil

_FRICTION: Final = 0.6  # of a lugged wheel on firm ground, as of ``Terrain`` [-]
_AT_REST: Final = 1e-6  # as of ``posture``: below it a velocity has no direction [m/s]


def rover_model(rover: Rover, soil: Soil | None) -> PlantModel:
    """The model of a rover in a soil or (None) on firm ground."""
    parameters = _parameters(rover, soil)
    names, n = [quantity.name for quantity in parameters], len(rover.wheels)
    inputs, outputs = rover_inputs(rover), rover_outputs(rover)
    observe = _observe_function(rover, soil, len(inputs), len(parameters), names.index("radius"))
    programs: dict[str, Program] = {
        "step": program_of(step_function(rover, soil)),
        "observe": program_of(observe),
        "loads": program_of(load_function(rover, soil)),
    }
    if soil is not None:
        programs["lift"] = program_of(lift_function(rover, soil))
    interface = interface_of(parameters, start_quantities("the body's centre"), inputs, outputs, observe, programs)
    unread = [quantity for k, quantity in enumerate(parameters) if k in interface.fixed]
    in_state, in_input = RoverState(*slices(state_sizes(n))), RoverInput(*slices(input_sizes(n)))
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
        internal_step=None,
        stepping=f"A communication step is divided into equal steps of at most {1e3 * LONGEST_STEP * TICK:g} ms.",
        fixed=[
            *fixed_values(rover, unread),
            *((f"wheels.{k}.{axis}", f"{getattr(wheel, axis):g}, in proportion to {size}")
              for k, wheel in enumerate(rover.wheels)
              for axis, size in (("x", "wheels.half_length"), ("y", "wheels.half_width"))),
            *([] if soil is None else [(f"soil.{path}", value) for path, value in fixed_values(soil, [])]),
        ],
    )  # fmt: skip


def rover_inputs(rover: Rover) -> list[Quantity]:
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
        Quantity("friction", "-", "friction coefficient of firm ground", _FRICTION),
        *numbered("ground_height", "m", [f"height of the ground at {name}: lifts the body" for name in wheels]),
    ]  # fmt: skip


def rover_outputs(rover: Rover) -> list[Quantity]:
    """Outputs: everything that ``RoverTruth`` has, the body's pose as position and angles."""
    wheels = [wheel.name for wheel in rover.wheels]
    return [
        Quantity("x", "m", "position of the body's centre in the world"),
        Quantity("y", "m", "position of the body's centre in the world"),
        Quantity("psi", "rad", "heading, + left, continuous"),
        Quantity("v_x", "m/s", "velocity of the body's centre along the body"),
        Quantity("v_y", "m/s", "velocity of the body's centre across the body, + left"),
        Quantity("yaw_rate", "rad/s", "about the ground's normal"),
        *(Quantity(f"body_{axis}", "m", "origin of the body in the world, sinkage included") for axis in "xyz"),
        Quantity("body_roll", "rad", "of the body about its x axis, third"),
        Quantity("body_pitch", "rad", "of the body about the y axis, second, + nose down"),
        Quantity("body_yaw", "rad", "of the body about the z axis, first; -pi to pi"),
        *(
            quantity
            for axis in "xyz"
            for quantity in numbered(f"wheel_{axis}", "m", [f"lowest point of {name} in the world" for name in wheels])
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


def _parameters(rover: Rover, soil: Soil | None) -> list[Quantity]:
    """Numbers in the order of ``equations.numbers``."""
    found = [number_quantity(rover, key, value) for key, value in rover if isinstance(value, float)]
    if soil is not None:
        found += [number_quantity(soil, key, value, "soil.") for key, value in soil if isinstance(value, float)]
    length, width = (float(size) for size in rover.footprint[:2])
    found.append(Quantity("wheels.half_length", "m", "x of the foremost wheels; the others in proportion", length))
    found.append(Quantity("wheels.half_width", "m", "y of the outermost left wheels; the others in proportion", width))
    assert np.array_equal([quantity.start for quantity in found], numbers(rover, soil))
    return found


def _observe_function(rover: Rover, soil: Soil | None, n_inputs: int, n_numbers: int, radius: int) -> Any:
    """Function (state, inputs, numbers) -> outputs, in the order of ``rover_outputs``."""
    n = len(rover.wheels)
    x, u, p = vector(sum(state_sizes(n))), vector(n_inputs), vector(n_numbers)
    s = RoverState(*parts(x, state_sizes(n)))
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
