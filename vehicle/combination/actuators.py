"""Actuators: steering, powertrain with endurance brake, and service brakes with ABS, as CasADi expressions.

The ratio is continuous: the force is limited by that of the lowest gear, then by the power. Differentials are open. A
governor ends the torque of a wheel at the largest speed of its rim: in the gear that belongs to the road speed, or with
traction control, which acts on each wheel by itself, at its slip. Not modelled: shifts.

The driver's demanded deceleration reaches the axles' valves with a lag. There it becomes a pressure: brake forces in
proportion to the static axle loads (``load``), or one pressure for all axles (``pressure``), with the demanded sum. The
pressure in the chambers follows with a second lag and at most at the rate at which air flows in, so that a full brake
application rises after a delay. An ABS modulator lets the pressure out while its wheel slips too much. Pressures are
over the full one.

The slip is the true one; a real ABS estimates the vehicle's speed from the wheels. Not modelled: store of air, fade.
"""

from collections.abc import Sequence
from functools import reduce
from typing import Final, NamedTuple

import casadi as ca

from vehicle.combination.description import AirDrag, BrakeChannel, Vehicle
from vehicle.combination.layout import Chain, ChainWheel, Input, State
from vehicle.combination.unit import Brakes
from vehicle.tyres import Num


def limited(value: Num, low: float, high: float) -> Num:
    """The value clipped to [low, high]."""
    return ca.fmax(low, ca.fmin(high, value))


def steer_rate(angle: Num, demand: Num, *, lag: float, limit: float, rate_limit: float) -> Num:
    """Rate [rad/s] of a road-wheel angle [rad] that follows a demand [rad] within its limits."""
    return limited((limited(demand, -limit, limit) - angle) / lag, -rate_limit, rate_limit)


def demand_rate(acceleration: Num, demand: Num, *, lag: Num, braking: float, driving: float) -> Num:
    """Rate [m/s3] of the acceleration that drive and brake torques produce, which lags a demand [m/s2]."""
    return (limited(demand, -braking, driving) - acceleration) / lag


_CLUTCH_OMEGA: Final = 1.0  # below it the clutch slips, and the engine's power does not limit the torque [rad/s]
_LEAST_SPEED: Final = 0.1  # avoids division by zero where the force limits a retarder anyway [m/s]


class DriveTorque(NamedTuple):
    """Torque of the driveline on one wheel."""

    torque: Num  # in the gear's direction if it drives forward [N m]
    per_spin: Num  # by which it falls with the spin at the governor [N m s]


def drive_torque(
    vehicle: Vehicle, wheel: ChainWheel, acceleration: Num, gear: Num, omega: Num, v_x: Num
) -> DriveTorque:
    """Driving torque on a wheel under a demand [m/s2] behind its lag, within the limits of engine and governor.

    A wheel that still turns the other way is slowed by the slipping clutch, at the demanded torque. ``v_x`` is the
    wheel's velocity along its plane [m/s].
    """
    radius, powertrain = wheel.axle.wheel_radius, vehicle.powertrain
    force = vehicle.mass * ca.fmax(acceleration, 0.0)
    if powertrain is not None:
        force = ca.fmin(force, powertrain.launch_force)
    turning = gear * omega
    available = vehicle.drive.max_power / ca.fmax(turning, _CLUTCH_OMEGA)
    torque = wheel.drive_share * ca.fmin(radius * force, available)
    if powertrain is None:
        return DriveTorque(gear * torque, 0.0)
    travel = ca.fmax(gear * v_x, 0.0)
    if powertrain.traction_control:
        governed = (1.0 + powertrain.traction_slip) * travel + powertrain.traction_slip_speed
    else:
        governed = ca.fmax(powertrain.overspeed * travel, powertrain.lowest_gear_speed)
    per_band = 1.0 / powertrain.governor_band
    room = per_band * (ca.fmin(governed, powertrain.top_speed) - radius * turning)
    open_ = ca.fmax(ca.fmin(room, 1.0), 0.0)
    falling = ca.logic_and(room > 0.0, room < 1.0)
    return DriveTorque(gear * open_ * torque, falling * ((radius * per_band) * torque))


def retards_first(vehicle: Vehicle) -> bool:
    """True if an endurance brake acts before the service brakes."""
    retarder = None if vehicle.powertrain is None else vehicle.powertrain.retarder
    return retarder is not None and retarder.acts_first


def retarding(vehicle: Vehicle, acceleration: Num, v_x: Num) -> Num:
    """Force [N] at all driven treads of an endurance brake that acts first, under a demand [m/s2] at a speed [m/s]."""
    if not retards_first(vehicle):
        return 0.0
    return ca.fmin(-vehicle.mass * ca.fmin(acceleration, 0.0), retarder_capacity(vehicle, v_x))


def retarder_capacity(vehicle: Vehicle, v_x: Num) -> Num:
    """Largest force [N] of the endurance brake at a speed [m/s]; 0 without one."""
    retarder = None if vehicle.powertrain is None else vehicle.powertrain.retarder
    if retarder is None:
        return 0.0
    speed = ca.fabs(v_x)
    building = (retarder.max_force / retarder.full_speed) * speed
    by_power = retarder.max_power / ca.fmax(speed, _LEAST_SPEED)
    return ca.fmin(ca.fmin(building, retarder.max_force), by_power)


def air_drag(air: AirDrag | None, v_x: Num) -> Num:
    """Force [N] of the air against the motion at a speed [m/s] in still air; it acts on the tractor. 0 without data."""
    if air is None:
        return 0.0
    return (0.5 * air.density * air.drag_area) * v_x * ca.fabs(v_x)


class BrakeStates(NamedTuple):
    """States of the brakes, or their rates."""

    pressure: Sequence[Num]  # of every channel
    valve: Sequence[Num]  # of every modulator


def service_demand(chain: Chain, s: State[ca.SX]) -> Num:
    """Acceleration demanded of the service brakes [m/s2], not above 0: what the endurance brake does not do.

    The more modulators of driven wheels release, the less it does, too.
    """
    vehicle = chain.vehicle
    if not retards_first(vehicle):
        return ca.fmin(s.acceleration, 0.0)
    driven = [wheel for wheel in chain.wheels if wheel.axle.driven]
    engaged = sum(kept_pressure(chain, wheel, s) for wheel in driven) / len(driven)
    return ca.fmin(s.acceleration + engaged * retarder_capacity(vehicle, s.v_x) / vehicle.mass, 0.0)


def kept_pressure(chain: Chain, wheel: ChainWheel, s: State[ca.SX]) -> Num:
    """Share of the brake torque that the ABS modulator of a wheel lets act: 1, or down to 0 as it releases."""
    valve = None if wheel.brake is None else chain.channels[wheel.brake].valve
    return 1.0 if valve is None else 1.0 - s.brake_valve[valve]


def brake_decelerations(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> list[Num]:
    """Rate of every wheel's spin that its brakes can cause, not above 0 [rad/s2].

    ABS modulators of driven wheels reduce the endurance brake, too. The system does not know of failing brakes, nor of
    further ones with torques of their own.
    """
    vehicle = chain.vehicle
    demand, force = service_demand(chain, s), retarding(vehicle, s.acceleration, s.v_x)
    rates: list[Num] = []
    for number, wheel in enumerate(chain.wheels):
        per_inertia = 1.0 / wheel.axle.wheel_inertia
        per_force = wheel.axle.wheel_radius * per_inertia
        rate: Num = 0.0
        if vehicle.brakes is None:
            rate = (vehicle.mass * wheel.brake_share * per_force) * demand
        elif wheel.brake is not None and wheel.axle.brake is not None:
            rate = (-0.5 * per_inertia * wheel.axle.brake.torque) * s.brake_pressure[wheel.brake]
            rate = u.brake_share[number] * rate if vehicle.has_failing_brakes else rate
        if wheel.axle.driven and retards_first(vehicle):
            rate = rate - (per_force * wheel.drive_share) * (kept_pressure(chain, wheel, s) * force)
        if vehicle.has_torque_inputs:
            rate = rate - (0.5 / wheel.axle.wheel_inertia) * ca.fmax(u.brake_torque[number // 2], 0.0)
        rates.append(rate)
    return rates


def brake_rates(chain: Chain, s: State[ca.SX], travel: Sequence[Num], spin_rates: Sequence[Num]) -> BrakeStates:
    """Rates of pressures and valves [1/s]; ``travel`` and ``spin_rates`` as for ``valve_commands``."""
    system = chain.vehicle.brakes
    if system is None:
        return BrakeStates([], [])
    commands = valve_commands(chain, system, s, travel, spin_rates)
    valves = ca.vertsplit(s.brake_valve)
    closing = [
        (1.0 / system.abs_valve_lag) * (command - valve) for command, valve in zip(commands, valves, strict=True)
    ]
    return BrakeStates(_pressure_rates(chain, system, s, ca.vertsplit(s.brake_pressure), valves), closing)


def brakes_later(
    chain: Chain, s: State[ca.SX], travel: Sequence[Num], spin_rates: Sequence[Num], step: Num
) -> BrakeStates:
    """Pressures and valves after a ``step`` [s], of second order in it.

    ``s`` has the brakes at the start of the step and all else in its middle, as ``spin_rates`` [rad/s2]; ``travel`` is
    as for ``valve_commands``. A command is held over the step; under it the valve's exponential is exact.
    """
    system = chain.vehicle.brakes
    if system is None:
        return BrakeStates([], [])
    commands = valve_commands(chain, system, s, travel, spin_rates)
    valves, pressures = ca.vertsplit(s.brake_valve), ca.vertsplit(s.brake_pressure)
    kept = ca.exp((-1.0 / system.abs_valve_lag) * step)
    later = [command + kept * (valve - command) for command, valve in zip(commands, valves, strict=True)]
    middle = [0.5 * (valve + then) for valve, then in zip(valves, later, strict=True)]
    first = _pressure_rates(chain, system, s, pressures, valves)
    halfway = [pressure + (0.5 * step) * rate for pressure, rate in zip(pressures, first, strict=True)]
    rates = _pressure_rates(chain, system, s, halfway, middle)
    return BrakeStates([pressure + step * rate for pressure, rate in zip(pressures, rates, strict=True)], later)


def _pressure_rates(
    chain: Chain, system: Brakes, s: State[ca.SX], pressures: Sequence[Num], valves: Sequence[Num]
) -> list[Num]:
    """Rate of every channel's pressure [1/s]."""
    demand, shares = -service_demand(chain, s), _pressure_shares(chain)
    rates: list[Num] = []
    for channel, pressure in zip(chain.channels, pressures, strict=True):
        target = ca.fmin(shares[channel.unit, channel.axles[0]] * demand, 1.0)
        rate = ca.fmin((1.0 / channel.brake.lag) * (target - pressure), channel.brake.fill_rate)
        if channel.valve is not None:
            rate = rate - valves[channel.valve] * (rate + (1.0 / system.abs_release_lag) * pressure)
        rates.append(rate)
    return rates


def valve_commands(
    chain: Chain, system: Brakes, s: State[ca.SX], travel: Sequence[Num], spin_rates: Sequence[Num]
) -> list[Num]:
    """Commands of the ABS modulators: 1 releases the pressure, 0 lets it in.

    ``travel`` is the magnitude of each wheel's velocity along its plane [m/s], ``spin_rates`` are theirs [rad/s2]. Of
    several wheels the one that slips most decides; those on one side of a unit have the same velocity.
    """
    limit = system.abs_slip * ca.fabs(s.v_x) + system.abs_slip_speed  # slip speed of all modulators [m/s]
    commands: list[Num] = []
    for number, channel in enumerate(chain.channels):
        if channel.valve is None:
            continue
        held = 1.0 - system.abs_hysteresis * s.brake_valve[channel.valve]
        slips: list[Num] = []  # slip speed on each side [m/s]
        for side in (+1, -1):
            wheels = [k for k, wheel in enumerate(chain.wheels) if wheel.brake == number and wheel.side == side]
            treads = [_predicted_tread(system, chain.wheels[k], s.omega[k], spin_rates[k]) for k in wheels]
            if treads:
                slips.append(travel[wheels[0]] - reduce(ca.fmin, treads))
        commands.append(reduce(ca.fmax, slips) > held * limit)
    return commands


def _predicted_tread(system: Brakes, wheel: ChainWheel, omega: Num, spin_rate: Num) -> Num:
    """Speed of a wheel's tread [m/s] a little later, at its present rate."""
    return wheel.axle.wheel_radius * ca.fabs(omega + system.abs_lead * spin_rate)


def _pressure_shares(chain: Chain) -> dict[tuple[int, int], Num]:
    """Pressure over the demanded deceleration [s2/m] by unit and first axle of a channel."""
    vehicle, system, loads = chain.vehicle, chain.vehicle.brakes, chain.static_loads
    channels = {(channel.unit, channel.axles[0]): channel for channel in chain.channels}
    forces = {key: _force(vehicle, channel) for key, channel in channels.items()}
    carried = {key: sum(loads[channel.unit][k] for k in channel.axles) for key, channel in channels.items()}
    if system is not None and system.distribution == "load":
        per_load = vehicle.mass / sum(carried.values())
        return {key: per_load * carried[key] / forces[key] for key in channels}
    per_force = vehicle.mass / sum(forces.values())
    return dict.fromkeys(channels, per_force)


def _force(vehicle: Vehicle, channel: BrakeChannel) -> Num:
    """Force [N] at the treads of all wheels of a group at full pressure."""
    axles = [vehicle.units[channel.unit].axles[k] for k in channel.axles]
    return sum(axle.brake.torque / axle.wheel_radius for axle in axles if axle.brake)
