"""The tractor's data sheet for its driver, from the vehicle's file."""

from __future__ import annotations

from controllers.tractor import TractorAxle, TractorDynamics, TractorGeometry
from vehicle.combination.data_sheet import coupling_loads
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads


def tractor_guided_at(vehicle: Vehicle, point: tuple[float, float]) -> TractorGeometry:
    """The data sheet for a driver who guides this point of T [m].

    Raises:
        ValueError: if the tractor cannot be steered.
    """
    tractor = vehicle.units[0]
    if tractor.steering is None:
        raise ValueError(f"vehicle {vehicle.name}: the tractor has no steering")
    return TractorGeometry(
        wheelbase=tractor.steered_axles[0].x,  # frame T has its origin at the rear axle
        x_ref=point[0],
        y_ref=point[1],
        max_steer=tractor.steering.limit,
        max_steer_rate=tractor.steering.rate_limit,
        actuator_lag=tractor.steering.lag,
        dynamics=_dynamics(vehicle),
    )


def _dynamics(vehicle: Vehicle) -> TractorDynamics:
    tractor, loads = vehicle.units[0], static_axle_loads(vehicle)[0]
    on_hitch = coupling_loads(vehicle)[1] if len(vehicle.units) > 1 else None
    # The foremost axle of every actuator turns by the demand.
    ratios = {k: r / a.ratios[0] for a in tractor.actuators for k, r in zip(a.axles, a.ratios, strict=True)}
    return TractorDynamics(
        mass=tractor.mass,
        yaw_inertia=tractor.yaw_inertia,
        cg_x=tractor.cg_x,
        hitch_mass=max(on_hitch or 0.0, 0.0) / GRAVITY,
        hitch_x=tractor.rear_hitch[0],
        axles=tuple(
            TractorAxle(
                x=axle.x,
                stiffness=float(load * axle.tyre.stiffness(0.5 * load).y),
                relaxation_length=axle.tyre.relaxation_length,
                trail=float(axle.tyre.trail(0.5 * load, 1.0)),
                steer_ratio=ratios.get(k, 0.0),
            )
            for k, (axle, load) in enumerate(zip(tractor.axles, map(float, loads), strict=True))
        ),
    )
