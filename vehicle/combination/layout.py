"""Vectors of the chain and of a plant step by name (state, input, output, ground), and the wheels.

The order of the fields is the order in the vector, so that no index appears in the code.
"""

from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Any, Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.description import GRAVITY, BrakeChannel, Vehicle, brake_channels, channel_of_wheel
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import UnitSprings, springs_of
from vehicle.combination.unit import Axle, Steering, Unit

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class State(NamedTuple, Generic[V]):
    """State of the chain; the field order is the order in the vector. Wheels: front to rear, left before right."""

    x: V  # of To in W [m]
    y: V
    psi: V  # (N,) yaw of each unit [rad]
    v_x: V  # of To along the tractor's axes [m/s]
    v_y: V
    yaw_rate: V  # (N,) [rad/s]
    heave: V  # (N,) rise of each sprung body at its heave point above the smooth road [m]
    pitch: V  # (N,) of each sprung body from the smooth road's plane, + nose down [rad]
    roll: V  # (N,) the same, + left side up [rad]
    heave_spring: V  # (N,) heave velocity less the dampers' share of the road's motion [m/s]
    pitch_spring: V  # (N,) the same of pitch [rad/s]
    roll_spring: V  # (N,) the same of roll [rad/s]
    load_shift: V  # (n,) load that axles have given back to their group, of units with ``load_sharing`` [N]
    side_force: V  # (n_axles,) lagged force of the tyres of each axle across its unit [N]; () without suspensions
    hitch_x: V  # (N - 1,) lagged force at each hitch on the unit behind it, along that unit's axes [N]
    hitch_y: V  # (N - 1,)
    omega: V  # (n_wheels,) wheel spin [rad/s]
    deflection_x: V  # (n_wheels,) of each tyre along its wheel plane, as force over load at the nominal load [-]
    deflection_y: V  # (n_wheels,) and across it
    brake_windup: V  # (n_wheels,) acting brake torque and rolling drag over the available ones, -1 to 1
    # (n_twins,) deflection_x of the inner patch of every wheel with two; deflection_x then is the outer one's
    twin_x: V
    twin_y: V  # (n_twins,)
    steer: V  # (n_actuators,) angle of every steering actuator, front to rear [rad]
    acceleration: V  # demanded of drive torques and brakes, behind the lag [m/s2]
    brake_pressure: V  # (n_channels,) over the full one, of every brake channel [-]
    brake_valve: V  # (n_modulators,) 1: the ABS modulator releases the pressure, 0: it lets it in


class Input(NamedTuple, Generic[V]):
    """Input of the chain; the field order is the order in the vector."""

    steer: V  # (n_actuators,) demanded angle of every steering actuator, front to rear [rad]
    acceleration: V  # demanded [m/s2]
    gear: V  # +1 drives forward, -1 backward
    friction: V  # (n_wheels,) friction coefficient under each wheel [-]
    gravity_x: V  # (N,) gravity along the ground under each unit, along W's x [m/s2]
    gravity_y: V  # (N,) along W's y
    road: V  # (n_wheels,) height of the rough road under each wheel above the smooth one [m]
    wind: V  # (N,) velocity of the wind at each unit along W's y [m/s]; () of a vehicle that is not ``exposed``
    drive_torque: V  # (n_axles,) of a further drive on each axle, + forward [N m]; () without ``has_torque_inputs``
    brake_torque: V  # (n_axles,) of a further brake on each axle, not below 0 [N m]; () as above
    brake_share: V  # (n_wheels,) of each brake's torque that acts [-]; () without ``has_failing_brakes``


class Output(NamedTuple, Generic[V]):
    """Output of the chain: wheel quantities, and horizontal forces of the ground; orders as in ``State``."""

    load: V  # (n_wheels,) [N]
    slip_angle: V  # (n_wheels,) [rad]
    friction_used: V  # (n_wheels,) horizontal force over friction times load [-]
    force_x: V  # (N,) sum of the tyre forces on each unit, along the tractor's axes [N]
    force_y: V  # (N,)
    moment: V  # (N,) their moment about each unit's centre of gravity [N m]
    lateral_load_transfer: V  # (N,) right less left wheel loads over their sum; +-1: on the wheels of one side only


class ChainWheel(NamedTuple):
    """Position of a wheel and its shares of steering, torques and loads."""

    unit: int
    axle: Axle
    axle_in_unit: int
    side: int  # +1 left, -1 right
    steer: int | None  # number of the steering actuator that turns it
    steer_ratio: float  # angle of its axle over that of the actuator
    brake_share: float  # of the brake force of the whole combination, if the vehicle describes no brakes
    drive_share: float  # of its drive force
    roll_share: float  # of the unit's lateral load transfer [1/m]
    brake: int | None  # number of its brake channel
    twin: int | None  # number among the wheels with two contact patches

    @property
    def y(self) -> float:
        """Position to the left of the unit's axis [m]."""
        return 0.5 * self.side * self.axle.track


def wheels(vehicle: Vehicle) -> tuple[ChainWheel, ...]:
    """All wheels, front to rear, left before right; brakes by static load, drive torque in equal shares."""
    loads = static_axle_loads(vehicle)
    total = sum(sum(unit_loads) for unit_loads in loads)
    driven = 2 * sum(axle.driven for axle in vehicle.units[0].axles)
    actuators, channels = _actuator_numbers(vehicle), channel_of_wheel(vehicle)
    layout: list[ChainWheel] = []
    twins = 0
    for i, unit in enumerate(vehicle.units):
        for k, axle in enumerate(unit.axles):
            for side in (+1, -1):
                layout.append(
                    ChainWheel(
                        unit=i,
                        axle=axle,
                        axle_in_unit=k,
                        side=side,
                        steer=actuators.get((i, k)),
                        steer_ratio=axle.steer_ratio,
                        brake_share=0.5 * loads[i][k] / total,
                        drive_share=1.0 / driven if axle.driven else 0.0,
                        roll_share=loads[i][k] / sum(loads[i]) / axle.track,
                        brake=channels.get((i, k, side)),
                        twin=None if axle.twin_spacing is None else twins,
                    )
                )
                twins += axle.twin_spacing is not None
    return tuple(layout)


class Chain(NamedTuple):
    """A vehicle with the lists that its equations look up; they follow from its data and are built once."""

    vehicle: Vehicle
    wheels: tuple[ChainWheel, ...]  # front to rear, left before right
    static_loads: list[list[float]]  # of each axle of each unit [N]
    springs: list[UnitSprings] | None  # of each unit in roll; None: gradients and frequencies are given instead
    channels: tuple[BrakeChannel, ...]  # of the brakes
    actuators: tuple[Steering, ...]  # of the steering, front to rear

    @classmethod
    def of(cls, vehicle: Vehicle) -> "Chain":
        """Lists of a vehicle, whose numbers may be symbols."""
        return cls(
            vehicle=vehicle,
            wheels=wheels(vehicle),
            static_loads=static_axle_loads(vehicle),
            springs=springs_of(vehicle) if vehicle.has_springs else None,
            channels=brake_channels(vehicle),
            actuators=steering_actuators(vehicle),
        )

    @property
    def units(self) -> tuple[Unit, ...]:
        """The units, front to rear."""
        return self.vehicle.units

    @property
    def axles(self) -> tuple[ChainWheel, ...]:
        """The left wheel of every axle, front to rear; the right one follows it in ``wheels``."""
        return self.wheels[::2]


def steering_actuators(vehicle: Vehicle) -> tuple[Steering, ...]:
    """The data of every steering actuator, front to rear."""
    return tuple(
        steering
        for unit in vehicle.units
        for actuator in unit.actuators
        if (steering := unit.steering_of(unit.axles[actuator.axles[0]])) is not None
    )


def turned_axles(vehicle: Vehicle) -> tuple[tuple[tuple[int, float], ...], ...]:
    """Axles turned by every actuator: number among the steered ones, front to rear, and angle over the actuator's."""
    turned, before = [], 0
    for unit in vehicle.units:
        number = {axle: before + n for n, axle in enumerate(k for k, axle in enumerate(unit.axles) if axle.steered)}
        before += len(number)
        for actuator in unit.actuators:
            turned.append(tuple((number[k], ratio) for k, ratio in zip(actuator.axles, actuator.ratios, strict=True)))
    return tuple(turned)


def _actuator_numbers(vehicle: Vehicle) -> dict[tuple[int, int], int]:
    """Number in the state of the actuator of every steered axle, by unit and axle in it."""
    groups = [(i, actuator.axles) for i, unit in enumerate(vehicle.units) for actuator in unit.actuators]
    return {(i, axle): number for number, (i, axles) in enumerate(groups) for axle in axles}


def state_sizes(vehicle: Vehicle) -> State[int]:
    """Length of every part of the state vector."""
    N, n_wheels = len(vehicle.units), vehicle.n_wheels
    channels = brake_channels(vehicle)
    n_twins = 2 * sum(axle.twin_spacing is not None for unit in vehicle.units for axle in unit.axles)
    return State(
        x=1,
        y=1,
        psi=N,
        v_x=1,
        v_y=1,
        yaw_rate=N,
        heave=N,
        pitch=N,
        roll=N,
        heave_spring=N,
        pitch_spring=N,
        roll_spring=N,
        load_shift=sum(len(unit.axles) for unit in vehicle.units if unit.load_sharing is not None),
        side_force=n_wheels // 2 if vehicle.has_springs else 0,
        hitch_x=N - 1,
        hitch_y=N - 1,
        omega=n_wheels,
        deflection_x=n_wheels,
        deflection_y=n_wheels,
        brake_windup=n_wheels,
        twin_x=n_twins,
        twin_y=n_twins,
        steer=len(steering_actuators(vehicle)),
        acceleration=1,
        brake_pressure=len(channels),
        brake_valve=sum(channel.valve is not None for channel in channels),
    )


def input_sizes(vehicle: Vehicle) -> Input[int]:
    """Length of every part of the input vector."""
    N, n_wheels = len(vehicle.units), vehicle.n_wheels
    return Input(
        steer=len(steering_actuators(vehicle)),
        acceleration=1,
        gear=1,
        friction=n_wheels,
        gravity_x=N,
        gravity_y=N,
        road=n_wheels,
        wind=N if vehicle.exposed else 0,
        drive_torque=n_wheels // 2 if vehicle.has_torque_inputs else 0,
        brake_torque=n_wheels // 2 if vehicle.has_torque_inputs else 0,
        brake_share=n_wheels if vehicle.has_failing_brakes else 0,
    )


def output_sizes(vehicle: Vehicle) -> Output[int]:
    """Length of every part of the output vector."""
    N, n_wheels = len(vehicle.units), vehicle.n_wheels
    return Output(
        load=n_wheels,
        slip_angle=n_wheels,
        friction_used=n_wheels,
        force_x=N,
        force_y=N,
        moment=N,
        lateral_load_transfer=N,
    )


def parts(vector: Any, sizes: Iterable[int]) -> list[Any]:
    """A vector (numpy array or ``casadi.SX``) cut into consecutive parts of these sizes."""
    return [vector[start:stop] for start, stop in pairwise(accumulate(sizes, initial=0))]


class CommandInputs(NamedTuple, Generic[V]):
    """Command of driver and trailer controllers; the field order is the order in the vector."""

    steer: V  # of the tractor's foremost steered axle; linked axles follow by their ratio [rad]
    acceleration: V  # above 0 drives the way the gear does, below 0 brakes [m/s2]
    trailer_steer: V  # of every axle that a law turns, front to rear [rad]
    gear: V  # +1 forward, -1 backward
    drive_torque: V  # (n_axles,) of a further drive on each axle, + forward [N m]; () without ``has_torque_inputs``
    brake_torque: V  # (n_axles,) of a further brake on each axle, not below 0 [N m]; () as above
    brake_share: V  # (n_wheels,) of each brake's torque that acts [-]; () without ``has_failing_brakes``


class GroundInputs(NamedTuple, Generic[V]):
    """Ground under the vehicle; the field order is the order in the vector."""

    friction: V  # (n_wheels,) friction coefficient under each wheel [-]
    slope_x: V  # (N,) rise of the ground under each unit's centre of gravity, along W's x [-]
    slope_y: V  # (N,) along W's y [-]
    road: V  # (n_wheels,) height of the rough road under each wheel above the smooth one [m]
    wind: V  # (N,) velocity of the wind at each unit along W's y [m/s]; () of a vehicle that is not ``exposed``


def command_sizes(vehicle: Vehicle) -> CommandInputs[int]:
    """Length of every part of the vector."""
    of_chain = input_sizes(vehicle)
    return CommandInputs(1, 1, vehicle.n_by_law, 1, of_chain.drive_torque, of_chain.brake_torque, of_chain.brake_share)


def ground_input_sizes(vehicle: Vehicle) -> GroundInputs[int]:
    """Length of every part of the vector."""
    of_chain = input_sizes(vehicle)
    return GroundInputs(of_chain.friction, of_chain.gravity_x, of_chain.gravity_y, of_chain.road, of_chain.wind)


def slices(sizes: Iterable[int]) -> list[slice]:
    """Slices of a vector with parts of these sizes."""
    return [slice(start, stop) for start, stop in pairwise(accumulate(sizes, initial=0))]


def chain_input(vehicle: Vehicle, command: CommandInputs[ca.SX], ground: GroundInputs[ca.SX]) -> Input[ca.SX]:
    """Input of the chain.

    The driver's actuators turn their first axles by the driver's demand; every actuator of a law takes the mean of the
    demands of its axles.
    """
    tractor = vehicle.units[0]
    trailer_demands = dict(enumerate(ca.vertsplit(command.trailer_steer), start=tractor.n_by_driver))
    actuator_demands = [
        *(command.steer / actuator.ratios[0] for actuator in tractor.driver_actuators),
        *(
            sum(trailer_demands[axle] / ratio for axle, ratio in turned) / len(turned)
            for turned in turned_axles(vehicle)[len(tractor.driver_actuators) :]
        ),
    ]
    gravity_x, gravity_y = gravity_along(ground.slope_x, ground.slope_y)
    return Input(
        steer=ca.vertcat(ca.SX(0, 1), *actuator_demands),
        acceleration=command.acceleration,
        gear=command.gear,
        friction=ground.friction,
        gravity_x=gravity_x,
        gravity_y=gravity_y,
        road=ground.road,
        wind=ground.wind,
        drive_torque=command.drive_torque,
        brake_torque=command.brake_torque,
        brake_share=command.brake_share,
    )


def gravity_along(slope_x: ca.SX, slope_y: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Components of gravity along ground of these slopes, along W's x and y [m/s2]."""
    normal = GRAVITY / ca.sqrt(1.0 + slope_x**2 + slope_y**2)
    return -normal * slope_x, -normal * slope_y
