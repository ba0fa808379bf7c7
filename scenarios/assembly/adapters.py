"""Build vehicle, plant, geometry, outlines, course, surface and rig from scenario and vehicle files."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from controllers.tractor import TractorAxle, TractorDynamics, TractorGeometry
from controllers.trailer import Linkage, TrailerGeometry
from scenarios.catalogue import PLANT, Part, check_made, constructed, resolve
from scenarios.courses import Course
from scenarios.image_file import read_grey
from scenarios.options.course import ConstantSlipOptions
from scenarios.options.scenario import Scenario, TraceRigOptions
from scenarios.options.tables import CircleOptions, RectangleOptions, RigOptions, SurfaceOptions
from scenarios.results.swept_path import UnitOutline
from sensors.camera.rig import StereoRig
from vehicle.clock import TICK, Schedule
from vehicle.combination.data_sheet import coupling_loads
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import ConstantSlipPlant, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.combination.unit import Unit
from vehicle.combination.variants import changed_vehicle, with_load
from vehicle.foundation.plant_like import PlantLike
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import (
    Friction,
    FrictionImage,
    FrictionPatch,
    Gust,
    MeasuredRoad,
    PatchedFriction,
    Roughness,
    RoughProfile,
    SplitFriction,
    Surface,
    scattered_potholes,
)


def tractor_guided_at(vehicle: Vehicle, point: tuple[float, float]) -> TractorGeometry:
    """The data sheet for a driver who guides this point of T [m].

    Raises:
        ValueError: if the tractor cannot be steered.
    """
    tractor = vehicle.units[0]
    if tractor.steering is None:
        raise ValueError(f"vehicle {vehicle.name}: the tractor has no steering")
    return TractorGeometry(
        wheelbase=tractor.wheelbase,
        x_ref=point[0] + tractor.origin_x,  # the driver's frame has its origin at the rear axle
        y_ref=point[1],
        max_steer=tractor.steering.limit,
        max_steer_rate=tractor.steering.rate_limit,
        actuator_lag=tractor.steering.lag,
        dynamics=_dynamics(vehicle),
    )


def _dynamics(vehicle: Vehicle) -> TractorDynamics:
    tractor, loads = vehicle.units[0], static_axle_loads(vehicle)[0]
    on_hitch = coupling_loads(vehicle)[1] if len(vehicle.units) > 1 else None
    # The foremost axle of each of the driver's actuators turns by the demand.
    ratios = {k: r / a.ratios[0] for a in tractor.driver_actuators for k, r in zip(a.axles, a.ratios, strict=True)}
    if tractor.follow_x is not None:  # a law turns the others so that the turning point lies beside the middle
        front = tractor.steered_axles[0].x
        middle = 0.5 * (front - tractor.follow_x)
        ratios |= {k: 1.0 - (front - a.x) / middle for k, a in enumerate(tractor.axles) if a.steered_by_law}
    return TractorDynamics(
        mass=tractor.mass,
        yaw_inertia=tractor.yaw_inertia,
        cg_x=tractor.cg_x + tractor.origin_x,
        hitch_mass=max(on_hitch or 0.0, 0.0) / GRAVITY,
        hitch_x=tractor.rear_hitch[0],
        axles=tuple(
            TractorAxle(
                x=axle.x + tractor.origin_x,
                stiffness=float(load * axle.tyre.stiffness(0.5 * load).y),
                relaxation_length=axle.tyre.relaxation_length,
                trail=float(axle.tyre.trail(0.5 * load, 1.0)),
                steer_ratio=ratios.get(k, 0.0),
            )
            for k, (axle, load) in enumerate(zip(tractor.axles, map(float, loads), strict=True))
        ),
    )


def ground_friction(options: SurfaceOptions, centreline: FloatArray, measured: Friction | None = None) -> Friction:
    """The friction of the ground around a road with that centreline (n, 2) [m]; ``measured`` replaces the uniform one.

    Raises:
        ValueError: one line, if the image cannot be read.
    """
    friction: Friction = options.friction if measured is None else measured
    left, right = options.friction_left, options.friction_right
    if left is not None or right is not None:
        friction = SplitFriction(
            friction if left is None else left, friction if right is None else right, line=centreline
        )
    if options.friction_image is not None:
        friction = FrictionImage(
            _image_values(options.friction_image, options.friction_image_black, options.friction_image_white),
            cell=options.friction_image_scale,
            corner=(options.friction_image_x, options.friction_image_y),
            outside=friction,
        )
    return PatchedFriction(friction, [_patch(table) for table in options.patches]) if options.patches else friction


def _image_values(path: str, black: float, white: float) -> FloatArray:
    """Friction coefficients (ny, nx) of an image's grey values."""
    try:
        grey = read_grey(Path(path))
    except ValueError as error:
        raise ValueError(f"surface.friction_image = {error}") from None
    levels: FloatArray = black + (white - black) * (np.arange(256) / 255.0)
    return levels[grey]


def _patch(table: CircleOptions | RectangleOptions) -> FrictionPatch:
    if isinstance(table, CircleOptions):
        return FrictionPatch(x=table.x, y=table.y, friction=table.friction, rounding=table.radius, edge=table.edge)
    return FrictionPatch(
        x=table.x,
        y=table.y,
        friction=table.friction,
        heading=math.radians(table.heading_deg),
        half_length=0.5 * table.length,
        half_width=0.5 * table.width,
        edge=table.edge,
    )


def trailer_geometry(vehicle: Vehicle, unit: int) -> TrailerGeometry:
    """The data sheet of one led unit for its steering controller.

    Raises:
        ValueError: if the unit has no follow point, or no axle behind the point that leads it.
    """
    trailer = vehicle.led_unit(unit)
    if not trailer.axles:
        raise ValueError(f"vehicle {vehicle.name}: the driver steers all axles of unit '{trailer.name}'")
    if trailer.follow_x is None:
        raise ValueError(
            f"vehicle {vehicle.name}: unit '{trailer.name}' needs follow_x [m], the position of its follow point"
        )
    steering = trailer.steering
    return TrailerGeometry(
        follow_distance=-trailer.follow_x,
        axle_distances=tuple(-axle.x for axle in trailer.axles),
        steered=tuple(axle.steered for axle in trailer.axles),
        max_steer=steering.limit if steering else 0.0,
        max_steer_rate=steering.rate_limit if steering else 0.0,
        actuator_lag=steering.lag if steering else 0.0,
        linkages=_linkages(trailer),
    )


def _linkages(trailer: Unit) -> tuple[Linkage, ...]:
    """Linkages of the actuators that turn several axles, or one by another ratio than 1."""
    position = {axle: n for n, axle in enumerate(k for k, axle in enumerate(trailer.axles) if axle.steered)}
    plain = (1.0,)
    return tuple(
        Linkage(tuple(position[axle] for axle in actuator.axles), actuator.ratios)
        for actuator in trailer.actuators
        if actuator.ratios != plain
    )


def vehicle_of(scenario: Scenario) -> Vehicle:
    """The scenario's vehicle in its load case, with ``steer_groups`` applied to the axles that laws turn.

    A vehicle that tows nothing has its frame at the point that leads it, see ``Vehicle.led``.

    Raises:
        ValueError: one line, if there is no such vehicle, or its file has no payload for the load case.
    """
    return described_vehicle(scenario).led()


def described_vehicle(scenario: Scenario) -> Vehicle:
    """The same in the frame of its file."""
    vehicle = with_load(load_vehicle(scenario.vehicle), scenario.load)
    if scenario.steer_groups == "vehicle":
        return vehicle
    group = {"single": "all", "common_centre": None}[scenario.steer_groups]
    return vehicle.model_copy(
        update={"units": tuple(_grouped(unit, group, is_first=k == 0) for k, unit in enumerate(vehicle.units))}
    )


def _grouped(unit: Unit, group: str | None, *, is_first: bool) -> Unit:
    """The unit with all axles that a law turns in one steer group; None: an actuator for each axle."""
    change = {"steer_group": group, "steer_ratio": 1.0}
    axles = tuple(
        axle.model_copy(update=change) if axle.steered and (axle.steered_by_law or not is_first) else axle
        for axle in unit.axles
    )
    return unit.model_copy(update={"axles": axles})


def watched_units(vehicle: Vehicle) -> tuple[int, ...]:
    """Indices of the units that are judged: those with a follow point and steered axles, and the last."""
    last = len(vehicle.units) - 1
    towed = ((i, vehicle.units[i]) for i in range(1, last))
    return (*(i for i, unit in towed if unit.steered_axles and unit.follow_x is not None), last)


def course_of(scenario: Scenario, vehicle: Vehicle) -> Course:
    """The course as this vehicle's tractor drives it.

    Raises:
        ValueError: one line, if the tractor cannot drive it, or a user's own kind makes no course.
    """
    kind, ahead = scenario.course.kind, vehicle.units[0].origin_x
    tractor = vehicle.units[0].shifted(-ahead)  # courses expect the frame at the rear-axle centre
    course = constructed("course.kind", kind, lambda: scenario.course.course(tractor, scenario.speed))
    if not isinstance(course, Course):
        raise ValueError(f"course.kind = {kind}: made a {type(course).__name__}, not a scenarios.courses.Course")
    if not ahead:
        return course
    x, y = course.reference
    return replace(course, start=course.start @ Pose2(ahead, 0.0, 0.0), reference=(x - ahead, y))


def outlines(vehicle: Vehicle) -> tuple[UnitOutline, ...]:
    """Outlines of a combination's bodies, tractor first."""
    return tuple(
        UnitOutline(
            name=unit.name,
            front_x=unit.front_x,
            rear_x=unit.rear_x,
            width=unit.width,
            axles=tuple(axle.x for axle in unit.axles),
            tracks=tuple(axle.track for axle in unit.axles),
            steer_signals=tuple(_steer_signals(unit, is_tractor=unit is vehicle.units[0])),
        )
        for unit in vehicle.units
    )


def _steer_signals(unit: Unit, *, is_tractor: bool) -> Iterator[str | None]:
    """Signal of each axle's steer angle; None for axles that are not steered."""
    by_driver = by_law = 0
    for axle in unit.axles:
        if not axle.steered:
            yield None
        elif is_tractor and not axle.steered_by_law:
            by_driver += 1
            yield "steer_tractor" if by_driver == 1 else f"steer_tractor_{by_driver}"
        else:
            by_law += 1
            yield f"steer_trailer_{by_law}_{unit.name}"


def surface_of(
    scenario: Scenario, course: Course, rng: np.random.Generator, measured: MeasuredRoad | None = None
) -> Surface:
    """The ground of the course and the gust across it; ``rng`` determines roughness and potholes.

    Raises:
        ValueError: one line, if the friction image cannot be read.
    """
    options, roughness = scenario.surface, None
    if options.roughness != "none" or options.potholes > 0.0 or measured is not None:
        profile_rng, holes_rng = rng.spawn(2)  # separate streams: neither depends on the other
        line, half_width = course.centreline, float(np.min(course.road_half_width))
        roughness = Roughness(
            profile=RoughProfile(profile_rng, options.roughness) if options.roughness != "none" else None,
            potholes=scattered_potholes(holes_rng, line, half_width, options.potholes) if options.potholes else None,
            measured=measured,
        )
    reliefs = (course.relief, measured.relief if measured else None)
    wind = scenario.wind
    return Surface(
        gust=Gust(speed=wind.speed, start=wind.start, length=wind.length, edge=wind.edge) if wind.speed else None,
        friction=ground_friction(options, course.centreline, course.friction),
        cross_fall=options.cross_fall,
        grade=options.grade,
        centre=course.surface_centre,
        reliefs=tuple(relief for relief in reliefs if relief is not None),
        roughness=roughness,
    )


def rig_on(trailer: Unit, geometry: TrailerGeometry, options: RigOptions) -> StereoRig:
    """The scenario's cameras on this trailer.

    Cameras that look to the rear or down are above the follow point. Side-facing ones are on their edge of the roof,
    half-way to the follow point.
    """
    x, y = {
        "rear": (-geometry.follow_distance, 0.0),
        "down": (-geometry.follow_distance, 0.0),
        "left": (-0.5 * geometry.follow_distance, 0.5 * trailer.width),
        "right": (-0.5 * geometry.follow_distance, -0.5 * trailer.width),
    }[options.facing]
    return StereoRig(
        facing=options.facing,
        width=options.width,
        height=options.height,
        hfov=math.radians(options.hfov_deg),
        x=x,
        y=y,
        z=options.camera_height,
        baseline=options.baseline,
    )


def rig_schedule(rig: RigOptions | TraceRigOptions, step: int = 1) -> Schedule:
    """Schedule of the cameras, with the latency of estimates, in steps of this many ticks.

    Raises:
        ValueError: one line, if period or latency is not a multiple of the step.
    """
    schedule = Schedule.at_rate(rig.rate_hz, latency=rig.latency, name="rig.rate_hz")
    check_schedule(schedule, step)
    return schedule


def check_schedule(schedule: Schedule, step: int, *, step_name: str = "") -> None:
    """Refuse cameras that are not synchronous with steps of this many ticks.

    Raises:
        ValueError: one line.
    """
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % step:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of {step_name}{step * TICK:g} s")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantContext:
    """Context from which a plant is constructed."""

    vehicle: Vehicle  # with the changes of ``plant.…``
    surface: Surface
    scenario: Scenario


class CombinationPlant(PlantLike[Truth, VehicleCommand], Protocol):
    """A plant of a combination."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State at a pose of the tractor, rolling straight at a speed [m/s]."""


class Multibody:
    """A chain of rigid bodies on slipping tyres; each body is sprung in heave, pitch and roll."""

    @classmethod
    def of(cls, context: PlantContext) -> CombinationPlant:
        """Plant of the vehicle on its surface."""
        return Plant(context.vehicle, context.surface)


class ConstantSlip:
    """Prescribed motion: the last trailer is dragged straight at the slip angle of a course ``constant-slip``."""

    @classmethod
    def of(cls, context: PlantContext) -> CombinationPlant:
        """Plant without dynamics."""
        scenario, course = context.scenario, context.scenario.course
        if not isinstance(course, ConstantSlipOptions):
            raise ValueError("plant.kind = constant_slip needs course.kind = constant-slip")
        if scenario.trailer_steering != "none":
            raise ValueError(
                f"trailer_steering = {scenario.trailer_steering}: the trailer of {scenario.name} is dragged at a "
                "constant slip angle and cannot be steered; use trailer_steering=none"
            )
        slip_angle, last = math.radians(course.slip_angle_deg), len(context.vehicle.units) - 1
        return ConstantSlipPlant(
            context.vehicle, context.surface, unit=last, slip_angle=slip_angle, speed=scenario.speed
        )


def plant_vehicle(scenario: Scenario) -> Vehicle:
    """The simulated vehicle: the scenario's with the changes of ``plant.…`` and ``brakes.…``.

    Raises:
        ValueError: one line, for a change that does not fit.
    """
    vehicle, changes = described_vehicle(scenario), scenario.plant.changes()
    changed = _with_systems(scenario, changed_vehicle(vehicle, changes) if changes else vehicle)
    for nominal, unit in zip(vehicle.units, changed.units, strict=True):
        if len(nominal.steered_axles) != len(unit.steered_axles):
            raise ValueError(f"plant.*: unit '{unit.name}' would have another number of steered axles")
    return changed.led()


def _with_systems(scenario: Scenario, vehicle: Vehicle) -> Vehicle:
    """The vehicle with the systems of ``brakes.…`` on or off; one without their data has none of them."""
    options = scenario.brakes
    vehicle = _switched(vehicle, "brakes", "abs", options.abs)
    return _switched(vehicle, "powertrain", "traction_control", options.traction_control)


def _switched(vehicle: Vehicle, table: str, system: str, on: bool | None) -> Vehicle:
    data = getattr(vehicle, table)
    if on and data is None:
        raise ValueError(f"brakes.{system} = true: the file of vehicle {vehicle.name} has no table [{table}]")
    if on is None or data is None:
        return vehicle
    return vehicle.model_copy(update={table: data.model_copy(update={system: on})})


def plant_kind(scenario: Scenario) -> str:
    """Name of the scenario's plant; by default as the course needs."""
    prescribed = isinstance(scenario.course, ConstantSlipOptions)
    if scenario.plant.fmu and scenario.plant.kind:
        raise ValueError("plant.kind and plant.fmu: give only one of them")
    return scenario.plant.fmu or scenario.plant.kind or ("constant_slip" if prescribed else "multibody")


def opened_plant(scenario: Scenario, vehicle: Vehicle, surface: Surface) -> CombinationPlant:
    """Open the scenario's plant for the simulated vehicle.

    Raises:
        ValueError: one line, if there is no such plant or it does not fit.
    """
    key, kind = "plant.fmu" if scenario.plant.fmu else "plant.kind", plant_kind(scenario)
    part: Part[PlantContext, CombinationPlant] = resolve(key, kind, PLANT)
    context = PlantContext(vehicle=vehicle, surface=surface, scenario=scenario)
    plant = constructed(key, kind, lambda: part.of(context))
    check_made(key, kind, plant, ("initial_state", "step", "observe"))
    return plant
