"""Checks of lateral motion: a step steer against an independent model, rearward amplification against theory.

Written from the textbooks, with no equation of the plant: every unit is a free rigid body in axes of W, the hitch is
two constraint equations whose forces are Lagrange multipliers, and each step of the integrator solves for accelerations
and multipliers together. Each wheel's slip relaxes by sigma / V ds/dt + s = tan(alpha), and its side force is the magic
formula of the relaxed slip. Steering is a first-order lag with a rate limit, and Ackermann's rule gives both wheels'
angles. Only the data of the vehicle file are shared: lengths, masses, tyres.

Loads are static: the tyres' stiffness is made proportional to load, so a transfer of load changes nothing that matters
to the yaw plane. Without rolling resistance and trail, and free-rolling wheels without inertia.

Open loop: the steer demand is one period of a sine at the frequency of ISO 14791's lane change, as high as linear
theory needs for 0.05 g at the tractor. Both are the ratio of peaks, at the last unit over the first. The linear model
comes from the same equations, so this finds what is not linear and what integration leaves; that the equations are
right is checked by derivations and by an independent multibody model.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from offtrack.studies.standards.proving_ground import amplification
from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from offtrack.studies.validation.simple_drives import with_each_tyre
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.layout import Input, input_sizes, parts
from vehicle.combination.linear import lateral_model, straight_running
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.unit import Axle, Unit
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface
from vehicle.tyres.laws import MagicFormulaTyre

_SPEED: Final = 60.0 / 3.6  # at the beginning; nothing drives [m/s]
_STEER: Final = math.radians(2.0)  # 0.2 g
_START: Final = 0.5  # of the step [s]
_END: Final = 6.0  # [s]
_ROW: Final = 0.02  # between compared rows [s]
_FRICTION: Final = 0.8
_G: Final = 9.80665  # [m/s2]
_STABILISED: Final = 20.0  # rate at which a gap of the hitch would close, after Baumgarte [1/s]
_TOLERANCE: Final = 0.01  # of the largest value, see `multibody_check`


class _SimpleWheel(NamedTuple):
    """A wheel of the independent model, in its unit's axes."""

    body: int
    x: float  # ahead of the centre of gravity [m]
    y: float  # to the left [m]
    load: float  # [N]
    steered: bool
    tyre: MagicFormulaTyre


class YawPlaneMotion(NamedTuple):
    """Yaw rates [rad/s] and lateral accelerations [m/s2] of both units, and the articulation [rad], over time."""

    time: FloatArray  # (n,) [s]
    yaw_rate: FloatArray  # (n, 2)
    lateral: FloatArray  # (n, 2) accelerations of the centres of gravity
    articulation: FloatArray  # (n,)


def multibody_check(quick: bool) -> CheckSection:
    """Motions of plant and independent model after a step of steer.

    The tolerance is 1 % of the largest value, about twice what is left (0.3 to 0.5 %). Known parts of that: the plant
    transfers load, which matters where both wheels of an axle slip differently; slip relaxes here and force in the
    plant, which differ where the tyre is not linear; and the plant's wheels have inertia.
    """
    vehicle = simple_vehicle()
    plant, other = of_plant(vehicle), independent(vehicle)
    rows = (
        ("yaw rate of the tractor", plant.yaw_rate[:, 0], other.yaw_rate[:, 0], "rad/s"),
        ("yaw rate of the semi-trailer", plant.yaw_rate[:, 1], other.yaw_rate[:, 1], "rad/s"),
        ("lateral acceleration of the tractor", plant.lateral[:, 0], other.lateral[:, 0], "m/s²"),
        ("lateral acceleration of the semi-trailer", plant.lateral[:, 1], other.lateral[:, 1], "m/s²"),
        ("articulation", plant.articulation, other.articulation, "rad"),
    )
    return CheckSection(
        title="Multibody model",
        text="Steer of 2° within the actuator's limits at 60 km/h, 0.2 g, on friction 0.8. The independent model has "
        "free bodies with constraint forces at the hitch, integrated by scipy, and the textbook's relaxing slip.",
        checks=tuple(
            Check(
                f"step steer at 60 km/h: largest difference of the {name}",
                float(np.abs(ours - theirs).max()),
                unit,
                tolerance=_TOLERANCE * float(np.abs(theirs).max()),
                source="independently written multibody model",
                remark=f"largest value {float(np.abs(theirs).max()):.4g} {unit}",
            )
            for name, ours, theirs, unit in rows
        ),
        plots=(_plot(plant, other),),
    )


def simple_vehicle() -> Vehicle:
    """European combination without any drag, on tyres without trail and with a stiffness in proportion to load."""
    simple = {"load_sensitivity": 0.0, "rolling_resistance": 0.0, "pneumatic_trail": 0.0}
    vehicle = with_each_tyre(load_vehicle("eu_tractor_semitrailer"), lambda axle: axle.tyre.model_copy(update=simple))
    return vehicle.model_copy(update={"air": None, "powertrain": None})


def of_plant(vehicle: Vehicle) -> YawPlaneMotion:
    """The motion of the plant."""
    plant = Plant(vehicle, Surface(friction=_FRICTION))
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), _SPEED)
    ticks, rows = round(_ROW / TICK), []
    time = np.arange(0.0, _END, _ROW)
    for t in time.tolist():
        truth = plant.observe(state, 0)
        rows.append((truth.velocities, truth.poses[0, 2] - truth.poses[1, 2]))
        state = plant.step(state, VehicleCommand(_STEER if t >= _START - 1e-9 else 0.0, 0.0, ()), ticks)
    lateral, yaw_rate = _lateral(vehicle, [row[0] for row in rows], _ROW)
    return YawPlaneMotion(time, yaw_rate, lateral, np.array([row[1] for row in rows]))


def independent(vehicle: Vehicle) -> YawPlaneMotion:
    """The motion of the independent model, whose state is (q, q', steer angle, slip of every wheel).

    q has x, y of the centre of gravity in W and yaw of both bodies.
    """
    tractor, trailer = vehicle.units
    wheels = _wheels(tractor, trailer)
    hitch = tractor.rear_hitch[0] - tractor.cg_x  # ahead of the tractor's centre of gravity [m]
    kingpin = -trailer.cg_x  # ahead of the trailer's [m]
    M = np.diag([tractor.mass, tractor.mass, tractor.yaw_inertia, trailer.mass, trailer.mass, trailer.yaw_inertia])
    q = np.array([tractor.cg_x, 0.0, 0.0, tractor.rear_hitch[0] + trailer.cg_x, 0.0, 0.0])
    start = np.concatenate([q, [_SPEED, 0.0, 0.0, _SPEED, 0.0, 0.0], [0.0], np.zeros(len(wheels))])

    def rate(t: float, state: FloatArray) -> FloatArray:
        q, v, steer, slip = state[:6], state[6:12], float(state[12]), state[13:]
        demand = _STEER if t >= _START else 0.0
        actuator = tractor.steering
        turning = 0.0 if actuator is None else (demand - steer) / actuator.lag
        fastest = 0.0 if actuator is None else math.radians(actuator.rate_limit_deg)
        relaxing, forces = np.empty(len(wheels)), np.zeros(6)
        for k, wheel in enumerate(wheels):
            relaxing[k] = _tyre(wheel, q, v, _wheel_angle(tractor, wheel, steer), float(slip[k]), forces)
        return np.concatenate(
            [v, _accelerations(M, q, v, forces, hitch, kingpin), [np.clip(turning, -fastest, fastest)], relaxing]
        )

    before = solve_ivp(rate, (0.0, _START - 1e-9), start, rtol=1e-9, atol=1e-10)
    time = np.arange(0.0, _END, _ROW)
    later = time[time >= _START - 1e-9]
    after = solve_ivp(rate, (_START, _END), before.y[:, -1], t_eval=np.maximum(later, _START), rtol=1e-9, atol=1e-10)
    rest = np.repeat(start[:, None], len(time) - len(later), axis=1)  # straight on: only the position changes
    states = np.concatenate([rest, after.y], axis=1).T
    return _motion(time, states, np.array([rate(t, state)[6:12] for t, state in zip(time, states, strict=True)]))


def _accelerations(
    M: FloatArray, q: FloatArray, v: FloatArray, forces: FloatArray, hitch: float, kingpin: float
) -> FloatArray:
    """q'' (6,) with the hitch's forces as multipliers: M q'' = F + J^T l, J q'' = -J' q' - stabilisation."""
    (x_1, y_1, psi_1, x_2, y_2, psi_2), (r_1, r_2) = q, (v[2], v[5])
    c_1, s_1, c_2, s_2 = math.cos(psi_1), math.sin(psi_1), math.cos(psi_2), math.sin(psi_2)
    gap = np.array([x_1 + hitch * c_1 - x_2 - kingpin * c_2, y_1 + hitch * s_1 - y_2 - kingpin * s_2])
    J = np.array(
        [[1.0, 0.0, -hitch * s_1, -1.0, 0.0, kingpin * s_2], [0.0, 1.0, hitch * c_1, 0.0, -1.0, -kingpin * c_2]]
    )
    centripetal = np.array(
        [-hitch * c_1 * r_1**2 + kingpin * c_2 * r_2**2, -hitch * s_1 * r_1**2 + kingpin * s_2 * r_2**2]
    )
    demanded = -centripetal - 2.0 * _STABILISED * (J @ v) - _STABILISED**2 * gap
    both = np.block([[M, -J.T], [J, np.zeros((2, 2))]])
    solution: FloatArray = np.linalg.solve(both, np.concatenate([forces, demanded]))
    return solution[:6]


def _tyre(wheel: _SimpleWheel, q: FloatArray, v: FloatArray, angle: float, slip: float, forces: FloatArray) -> float:
    """Rate of the wheel's slip [1/s]; its side force and moment are added to ``forces`` (6,), along W."""
    at = 3 * wheel.body
    psi = float(q[at + 2])
    c, s = math.cos(psi), math.sin(psi)
    arm_x, arm_y = c * wheel.x - s * wheel.y, s * wheel.x + c * wheel.y
    v_x, v_y = float(v[at] - v[at + 2] * arm_y), float(v[at + 1] + v[at + 2] * arm_x)
    c, s = math.cos(psi + angle), math.sin(psi + angle)  # of the wheel's plane
    along, across = c * v_x + s * v_y, -s * v_x + c * v_y
    side = -wheel.load * _FRICTION * _magic(wheel.tyre, slip / _FRICTION)
    forces[at] += -s * side
    forces[at + 1] += c * side
    forces[at + 2] += arm_x * c * side + arm_y * s * side
    return (across / abs(along) - slip) * abs(along) / wheel.tyre.relaxation_length


def _magic(tyre: MagicFormulaTyre, slip: float) -> float:
    """Side force over its largest value: sin(C atan(B s - E (B s - atan(B s)))) with B C the stiffness over load."""
    b = tyre.cornering_stiffness / tyre.shape * slip
    return math.sin(tyre.shape * math.atan(b - tyre.curvature * (b - math.atan(b))))


def _wheel_angle(tractor: Unit, wheel: _SimpleWheel, steer: float) -> float:
    """Angle of a wheel by Ackermann's rule: cot(angle) = cot(mean) - y / wheelbase."""
    if not wheel.steered or steer == 0.0:
        return 0.0
    wheelbase = wheel.x + tractor.cg_x  # the rear axle is at 0
    return math.atan(1.0 / (1.0 / math.tan(steer) - wheel.y / wheelbase))


def _wheels(tractor: Unit, trailer: Unit) -> list[_SimpleWheel]:
    """All wheels with their static loads, from the balance of moments of trailer and tractor."""
    axles = trailer.axles
    middle = sum(axle.x for axle in axles) / len(axles)
    group = trailer.mass * _G * trailer.cg_x / middle  # equal shares, so their middle carries them
    on_hitch = trailer.mass * _G - group
    front, rear = tractor.axles
    at_front = (tractor.mass * _G * (tractor.cg_x - rear.x) + on_hitch * (tractor.rear_hitch[0] - rear.x)) / (
        front.x - rear.x
    )
    loads = [at_front, tractor.mass * _G + on_hitch - at_front, *(group / len(axles) for _ in axles)]
    placed = [(0, tractor, front), (0, tractor, rear), *((1, trailer, axle) for axle in axles)]
    return [
        _SimpleWheel(body, axle.x - unit.cg_x, 0.5 * side * axle.track, 0.5 * load, axle.steered, _magic_formula(axle))
        for (body, unit, axle), load in zip(placed, loads, strict=True)
        for side in (1.0, -1.0)
    ]


def _magic_formula(axle: Axle) -> MagicFormulaTyre:
    if not isinstance(axle.tyre, MagicFormulaTyre):
        raise TypeError(f"the tyre of the independent model is a magic formula, not {axle.tyre.model}")
    return axle.tyre


def _motion(time: FloatArray, states: FloatArray, accelerations: FloatArray) -> YawPlaneMotion:
    yaw = states[:, [2, 5]]
    a_x, a_y = accelerations[:, [0, 3]], accelerations[:, [1, 4]]
    return YawPlaneMotion(time, states[:, [8, 11]], -np.sin(yaw) * a_x + np.cos(yaw) * a_y, yaw[:, 0] - yaw[:, 1])


def _plot(plant: YawPlaneMotion, other: YawPlaneMotion) -> Plot:
    series = []
    for k, name in enumerate(("tractor", "semi-trailer")):
        series.append(Series(f"{name}, plant", plant.time, plant.yaw_rate[:, k], "model"))
        series.append(Series(f"{name}, independent", other.time, other.yaw_rate[:, k], "reference"))
    return Plot(title="Step of steer at 60 km/h", x_label="time [s]", y_label="yaw rate [rad/s]", series=tuple(series))


_AMPLIFICATION_SPEED: Final = 88.0 / 3.6  # [m/s]
_FREQUENCY: Final = 0.4  # [Hz]
_PEAK: Final = 0.05 * GRAVITY  # [m/s2]
_AMPLIFICATION_FRICTION: Final = 0.8  # dry road
_PERIOD: Final = 10  # of the steer programme [ticks]
_DURATION: Final = 10.0  # the last unit has its peaks within 5 s [s]


def rearward_amplification(quick: bool) -> CheckSection:
    """Ratios of the peaks of lateral acceleration, by the plant and by linear theory."""
    names = ("eu_tractor_semitrailer", "a_double") if quick else vehicle_names()
    trains = [vehicle for vehicle in map(load_vehicle, names) if len(vehicle.units) > 1]
    motions = [(vehicle, *accelerations(vehicle)) for vehicle in trains]
    return CheckSection(
        title="Rearward amplification",
        text="One period of steer at 0.4 Hz and 88 km/h, which gives the tractor about 0.05 g. The vehicle's own "
        "tyres, suspensions and actuators, and the linear model of the same vehicle with all its lags.",
        checks=tuple(
            Check(
                f"{vehicle.name}: rearward amplification",
                amplification(of_plant[:, -1], of_plant[:, 0]),
                target=amplification(linear[:, -1], linear[:, 0]),
                tolerance=0.03 * amplification(linear[:, -1], linear[:, 0]),  # issue 18: 3 %
                source="linear theory with the same lags",
            )
            for vehicle, of_plant, linear in motions
        ),
        plots=(_amplification_plot(*motions[0]),),
    )


def accelerations(vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Lateral accelerations [m/s2] of the units' centres of gravity (n, N): of the plant, and by linear theory."""
    model = lateral_model(
        vehicle, _AMPLIFICATION_SPEED, outputs=("lateral_acceleration",), tyre_dynamics=True, actuators=True
    )
    amplitude = _PEAK / abs(complex(model.response("lateral_acceleration_0", _FREQUENCY)))
    time = np.arange(0.0, _DURATION, _PERIOD * TICK)
    steer = np.where(time < 1.0 / _FREQUENCY, amplitude * np.sin(2.0 * math.pi * _FREQUENCY * time), 0.0)
    system = (model.A, model.B[:, :1], model.C, model.D[:, :1])
    _, linear, _ = lsim(system, steer, time, interp=False)  # exact: the demand is constant in between
    return _accelerations_of_plant(vehicle, steer), linear.reshape(len(time), -1)


def _accelerations_of_plant(vehicle: Vehicle, steer: FloatArray) -> FloatArray:
    plant = Plant(vehicle, Surface(friction=_AMPLIFICATION_FRICTION))
    state, u = straight_running(vehicle, _AMPLIFICATION_SPEED, _AMPLIFICATION_FRICTION)
    drive = float(Input(*parts(u, input_sizes(vehicle))).acceleration[0])  # that holds the speed
    straight = (0.0,) * vehicle.n_by_law
    velocities = []
    for demand in steer.tolist():
        velocities.append(plant.observe(state, 0).velocities)
        state = plant.step(state, VehicleCommand(demand, drive, straight), _PERIOD)
    return _lateral(vehicle, velocities, _PERIOD * TICK)[0]


def _lateral(vehicle: Vehicle, velocities: Sequence[FloatArray], period: float) -> tuple[FloatArray, FloatArray]:
    """Lateral accelerations [m/s2] of the centres of gravity and yaw rates [rad/s], (n, N), from ``Truth``'s."""
    v_x, v_y, yaw_rate = np.moveaxis(np.array(velocities), 2, 0)
    at_cg = v_y + np.array([unit.cg_x for unit in vehicle.units]) * yaw_rate
    return np.gradient(at_cg, period, axis=0) + v_x * yaw_rate, yaw_rate


def _amplification_plot(vehicle: Vehicle, of_plant: FloatArray, linear: FloatArray) -> Plot:
    time: FloatArray = _PERIOD * TICK * np.arange(len(linear), dtype=np.float64)
    series = [
        series
        for k, name in ((0, "first unit"), (-1, "last unit"))
        for series in (
            Series(name, time, of_plant[:, k] / GRAVITY, "model"),
            Series(f"{name}, linear", time, linear[:, k] / GRAVITY, "reference"),
        )
    ]
    return Plot(
        title=f"One period of steer, {vehicle.name}",
        x_label="time [s]",
        y_label="lateral acceleration [g]",
        series=tuple(series),
    )
