"""Checks of rollover thresholds: by the roll-plane equations, by energy, on the tilt table, in a closing curve.

In a steady turn a combination stands where its potential energy has a minimum: weights and centrifugal forces, springs
in roll, tyres as springs that can only push, and fifth wheels. Angles are finite. Unknowns are the roll of every body
and the roll and height of every axle. The lateral acceleration rises until the minimum vanishes.

Only the data are shared with the model: neither its equations of roll nor its loads.
"""

import math
from typing import Any, Final

import casadi as ca
import numpy as np

from offtrack.studies.standards.static_rollover import closing_curve, tilt
from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.roll import static_rollover
from vehicle.combination.unit import Axle, Unit
from vehicle.combination.variants import with_load
from vehicle.frames import FloatArray

_g: Final = 9.81  # [m/s2]
_STEP: Final = 0.2  # [m/s2] of the search
_RESOLUTION: Final = 1e-3  # [m/s2]
_ITERATIONS: Final = 200
_AT_REST: Final = 1e-3  # [N, N m] largest slope of the energy in a minimum
_FALLEN: Final = 0.6  # [rad]


def rollover_by_energy(vehicle: Vehicle, *, on_table: bool = False) -> float:
    """Lateral acceleration [m/s2] beyond which the combination tips; on a tilt table its slope times g.

    On the table the weight across it is less than in a turn, and with it the roll that it causes, and the load that
    holds a fifth wheel's plate down.
    """
    energy, start = _energy(vehicle)
    x = _minimum(energy, start, np.array([0.0, _g]), len(vehicle.units))
    assert x is not None
    low, step = 0.0, _STEP
    while step > _RESOLUTION:
        level = low + step
        share = 1.0 / math.hypot(1.0, level / _g) if on_table else 1.0
        found = _minimum(energy, x, share * np.array([level, _g]), len(vehicle.units))
        if found is None:
            step *= 0.5
        else:
            x, low = found, low + step
    return low


def _minimum(energy: Any, x: FloatArray, field: FloatArray, bodies: int) -> FloatArray | None:
    """Minimum of the energy near x by Newton's method with line search; None if the bodies fall over.

    ``field`` is the acceleration to the side and the one downward [m/s2].
    """
    for _ in range(_ITERATIONS):
        value, slope, curvature = (np.array(part) for part in energy(x, field))
        if np.abs(slope).max() < _AT_REST:
            return x if np.linalg.eigvalsh(curvature)[0] > 0.0 else None
        values, directions = np.linalg.eigh(curvature)
        damped = np.maximum(np.abs(values), 1e3)  # [N m/rad] downhill where the energy curves the other way
        step = -(directions @ ((directions.T @ slope.ravel()) / damped))
        size = 1.0
        while float(energy(x + size * step, field)[0]) > value.item() and size > 1e-6:
            size *= 0.5
        x = x + size * step
        if np.abs(x[:bodies]).max() > _FALLEN:
            return None
    return None


def _energy(vehicle: Vehicle) -> tuple[Any, FloatArray]:
    """Function (unknowns, field) -> energy [J], its gradient and Hessian; and the unknowns at rest."""
    loads, couplings = _static_loads(vehicle)
    roll = [ca.SX.sym(f"roll_{i}") for i in range(len(vehicle.units))]
    angles, heights, rest = list[ca.SX](), list[ca.SX](), list[float]()
    field, total = ca.SX.sym("field", 2), ca.SX(0.0)
    hitch: tuple[Any, Any] = (0.0, 0.0)  # place of the hitch behind the unit at hand, to the left and up [m]
    for i, unit in enumerate(vehicle.units):
        supports: list[tuple[float, float, Any, Any]] = []  # load, height on the body, place to the left and up
        if i > 0:
            height = vehicle.units[i - 1].hitch_height or 0.0
            supports.append((couplings[i], height, *hitch))
            total += _fifth_wheel(unit, field[1] / _g * couplings[i], roll[i] - roll[i - 1])
        for axle, load in zip(unit.axles, loads[i], strict=True):
            assert axle.suspension is not None
            angle, rise = ca.SX.sym("angle"), ca.SX.sym("rise")
            angles.append(angle)
            heights.append(rise)
            rest.append(-0.5 * load / axle.suspension.tyre_stiffness)
            for side in (-0.5, 0.5):
                squeezed = ca.fmax(-(rise + side * axle.track * ca.sin(angle)), 0.0)
                total += 0.5 * axle.suspension.tyre_stiffness * squeezed**2
            total += 0.5 * _suspension(unit, axle) * (roll[i] - angle) ** 2
            h = axle.suspension.roll_centre_height
            supports.append((load, h, -h * ca.sin(angle), rise + h * ca.cos(angle)))

        def place(z: float, supports: Any = supports, angle: ca.SX = roll[i]) -> tuple[Any, Any]:
            """Point at a height on the body: mean over its supports, weighted by their loads."""
            whole = sum(load for load, *_ in supports)
            left = sum(load * (y - (z - h) * ca.sin(angle)) for load, h, y, _ in supports) / whole
            up = sum(load * (w + (z - h) * ca.cos(angle)) for load, h, _, w in supports) / whole
            return left, up

        left, up = place(unit.cg_height)
        total += unit.mass * (field[1] * up + field[0] * left)
        hitch = place(unit.hitch_height) if unit.hitch_height is not None else (0.0, 0.0)
    x = ca.vertcat(*roll, *angles, *heights)
    hessian, gradient = ca.hessian(total, x)
    start = np.concatenate([np.zeros(len(roll) + len(angles)), rest])
    return ca.Function("energy", [x, field], [total, gradient, hessian]), start


def _suspension(unit: Unit, axle: Axle) -> float:
    """Roll stiffness [N m/rad]; of front axles with the frame in series, each by its share."""
    assert axle.suspension is not None
    stiffness = axle.suspension.roll_stiffness
    frame = None if unit.roll is None else unit.roll.frame_stiffness
    if frame is None or not axle.suspension.at_front:
        return stiffness
    front = sum(a.suspension.roll_stiffness for a in unit.axles if a.suspension and a.suspension.at_front)
    return stiffness / front / (1.0 / front + 1.0 / frame)


def _fifth_wheel(unit: Unit, load: ca.SX, twist: ca.SX) -> ca.SX:
    """Energy of the fifth wheel: a spring up to separation, constant moment over the lash, a spring again."""
    if unit.coupling is None:
        return ca.SX(0.0)
    frame = None if unit.roll is None else unit.roll.frame_stiffness
    K = unit.coupling.roll_stiffness
    K = K if frame is None else 1.0 / (1.0 / K + 1.0 / frame)
    angle = ca.fabs(twist)
    edge = 0.5 * unit.coupling.plate_width * load / K
    beyond = ca.fmax(angle - edge, 0.0)
    caught = ca.fmax(angle - edge - unit.coupling.lash, 0.0)
    within = angle - beyond
    return 0.5 * K * within**2 + K * edge * beyond + 0.5 * K * caught**2


def _static_loads(vehicle: Vehicle) -> tuple[list[list[float]], list[float]]:
    """Loads of axles and of front hitches [N], by moments: groups share alike, others as springs under a beam."""
    loads: list[list[float]] = [[] for _ in vehicle.units]
    couplings = [0.0] * len(vehicle.units)
    behind = 0.0
    for i in reversed(range(len(vehicle.units))):
        unit = vehicle.units[i]
        forces = [(unit.mass * _g, unit.cg_x), (behind, unit.hitch_x or 0.0)]
        weight, moment = sum(F for F, _ in forces), sum(F * x for F, x in forces)
        whole = i > 0 and not any(axle.bogie for axle in unit.axles)
        names = ["all" if whole else axle.bogie or str(k) for k, axle in enumerate(unit.axles)]
        shares = [a.load_share for a in unit.axles]
        groups = list(dict.fromkeys(names))
        total = [sum(s for s, n in zip(shares, names, strict=True) if n == group) for group in groups]
        centre = [
            sum(s * a.x for s, a, n in zip(shares, unit.axles, names, strict=True) if n == group) / all_of
            for group, all_of in zip(groups, total, strict=True)
        ]
        k, x = np.array(total), np.array(centre)
        if i > 0:  # beam on a hinge at the hitch
            on_groups = k * x * moment / float(k @ x**2)
            couplings[i] = behind = weight - float(on_groups.sum())
        else:
            A = np.array([[k.sum(), k @ x], [k @ x, k @ x**2]])
            dip, pitch = np.linalg.solve(A, [weight, moment]).tolist()
            on_groups = k * (dip + pitch * x)
        by_group = dict(zip(groups, (on_groups / k).tolist(), strict=True))
        loads[i] = [s * by_group[n] for s, n in zip(shares, names, strict=True)]
    return loads, couplings


_QUICK: Final = (
    "eu_tractor_semitrailer", "us_5_axle", "b_double", "a_double", "rigid_truck_8x4", "desaxe_field_combination"
)  # fmt: skip
_OTHERS: Final = ("rigid_truck", "wb67", "uk_longer_semitrailer")
_DRIVEN: Final = ("eu_tractor_semitrailer", "rigid_truck", "a_double", "us_5_axle")
_LOADS: Final = ("full", "half")
_ENERGY: Final = "minimum of the potential energy, finite angles, unilateral tyre springs; 2 %: small angles"
_TABLE: Final = (
    "minimum of the potential energy on the slope; 4 %: the plant's axles roll as under their load on the level (2 %), "
    "and at 1° per second the bodies swing past their equilibrium (2 %)"
)
_CURVE: Final = "the tilt table; 8 %: in the curve axles share side forces by slip, and units have different radii"


def rollover(quick: bool) -> CheckSection:
    """Thresholds of several vehicles and loads by the model and by an independent calculation, and on the plant."""
    vehicles = [load_vehicle(name) for name in (_QUICK if quick else (*_QUICK, *_OTHERS))]
    cases = [(f"{v.name}, {load}", with_load(v, load)) for v in vehicles for load in _LOADS]
    model = [static_rollover(vehicle).threshold / GRAVITY for _, vehicle in cases]
    energy = [rollover_by_energy(vehicle) / GRAVITY for _, vehicle in cases]
    driven = [load_vehicle(name) for name in (_DRIVEN[:1] if quick else _DRIVEN)]
    return CheckSection(
        title="Rollover",
        text="The lateral acceleration that tips a combination: by the model's equations of roll, and by an "
        "independent calculation that searches the minimum of the potential energy. On the plant it is tilted, and "
        "steered slowly further into a curve, until it falls.",
        checks=(
            *(
                Check(
                    f"{name}: static rollover threshold",
                    value,
                    "g",
                    target=target,
                    tolerance=0.02 * target,
                    source=_ENERGY,
                )
                for (name, _), value, target in zip(cases, model, energy, strict=True)
            ),
            _audited(model[0]),
            *(check for vehicle in driven for check in _on_the_plant(vehicle)),
        ),
        plots=(_plot(np.array(energy), np.array(model)),),
    )


def _audited(threshold: float) -> Check:
    return Check(
        "eu_tractor_semitrailer: static rollover threshold against the audit of its data",
        threshold,
        "g",
        target=0.366,
        tolerance=0.04,
        source="0.70 of half the track over the height, the audit's own rule for the give of springs and tyres",
    )


def _on_the_plant(vehicle: Vehicle) -> tuple[Check, ...]:
    slope = rollover_by_energy(vehicle, on_table=True) / GRAVITY
    tilted = tilt(vehicle).figures["rollover_threshold_g"]
    curved = closing_curve(vehicle).figures["curve_rollover_g"]
    return (
        Check(f"{vehicle.name}: on the tilt table", tilted, "g", target=slope, tolerance=0.04 * slope, source=_TABLE),
        Check(
            f"{vehicle.name}: in a closing curve", curved, "g", target=tilted, tolerance=0.08 * tilted, source=_CURVE
        ),
    )


def _plot(energy: np.ndarray, model: np.ndarray) -> Plot:
    diagonal = np.array([0.9 * energy.min(), 1.05 * energy.max()])
    return Plot(
        title="Static rollover thresholds",
        x_label="by energy [g]",
        y_label="by the model [g]",
        series=(
            Series("equal", diagonal, diagonal, "reference"),
            Series("vehicles and loads", energy, model, "model points"),
        ),
        to_scale=True,
    )
