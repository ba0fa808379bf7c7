"""Build geometry, outlines, course, surface and rig from scenario and vehicle files."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from controllers.tractor import TractorGeometry
from controllers.trailer import Linkage, TrailerGeometry
from scenarios.assembly.ground_friction import ground_friction
from scenarios.assembly.tractor_data import tractor_guided_at
from scenarios.catalogue import constructed
from scenarios.courses import Course
from scenarios.options.rig import RigOptions
from scenarios.options.scenario import Scenario
from scenarios.results.swept_path import UnitOutline
from sensors.camera.rig import StereoRig
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.load_cases import with_load
from vehicle.combination.unit import Unit
from vehicle.surface import Gust, MeasuredRoad, Roughness, RoughProfile, SumOfReliefs, Surface, scattered_potholes


def trailer_geometry(vehicle: Vehicle, unit: int) -> TrailerGeometry:
    """The data sheet of one towed unit for its steering controller.

    Raises:
        ValueError: if the unit has no follow point.
    """
    trailer = vehicle.units[unit]
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
    """The scenario's vehicle in its load case, with ``steer_groups`` applied to its trailers.

    Raises:
        ValueError: one line, if there is no such vehicle, or its file has no payload for the load case.
    """
    vehicle = with_load(load_vehicle(scenario.vehicle), scenario.load)
    if scenario.steer_groups == "vehicle":
        return vehicle
    group = {"single": "all", "common_centre": None}[scenario.steer_groups]
    towed = (_grouped(unit, group) for unit in vehicle.units[1:])
    return vehicle.model_copy(update={"units": (vehicle.units[0], *towed)})


def _grouped(unit: Unit, group: str | None) -> Unit:
    """The unit with all its steered axles in one steer group; None: an actuator for each axle."""
    change = {"steer_group": group, "steer_ratio": 1.0}
    axles = tuple(axle.model_copy(update=change) if axle.steered else axle for axle in unit.axles)
    return unit.model_copy(update={"axles": axles})


def watched_units(vehicle: Vehicle, scenario: Scenario) -> tuple[int, ...]:
    """Indices of the units that are judged: those with a follow point and steered axles, and the last.

    Raises:
        ValueError: if the vehicle tows nothing.
    """
    if len(vehicle.units) < 2:
        raise ValueError(f"vehicle {vehicle.name} tows nothing: scenario {scenario.name} needs a trailer")
    last = len(vehicle.units) - 1
    towed = ((i, vehicle.units[i]) for i in range(1, last))
    return (*(i for i, unit in towed if unit.steered_axles and unit.follow_x is not None), last)


def course_of(scenario: Scenario, vehicle: Vehicle) -> Course:
    """The course as this vehicle's tractor drives it.

    Raises:
        ValueError: one line, if the tractor cannot drive it, or a user's own kind makes no course.
    """
    kind = scenario.course.kind
    course = constructed("course.kind", kind, lambda: scenario.course.course(vehicle.units[0], scenario.speed))
    if not isinstance(course, Course):
        raise ValueError(f"course.kind = {kind}: made a {type(course).__name__}, not a scenarios.courses.Course")
    return course


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
    k = 0
    for axle in unit.axles:
        k += axle.steered
        if not axle.steered:
            yield None
        elif is_tractor:
            yield "steer_tractor" if k == 1 else f"steer_tractor_{k}"
        else:
            yield f"steer_trailer_{k}_{unit.name}"


def tractor_geometry(vehicle: Vehicle, course: Course) -> TractorGeometry:
    """The tractor's data sheet for the driver on a course.

    Raises:
        ValueError: if the tractor cannot be steered.
    """
    return tractor_guided_at(vehicle, course.reference)


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
    reliefs = [relief for relief in (course.relief, measured.relief if measured else None) if relief is not None]
    wind = scenario.wind
    return Surface(
        gust=Gust(speed=wind.speed, start=wind.start, length=wind.length, edge=wind.edge) if wind.speed else None,
        friction=ground_friction(options, course.centreline, course.friction),
        cross_fall=options.cross_fall,
        grade=options.grade,
        centre=course.surface_centre,
        relief=SumOfReliefs(*reliefs) if len(reliefs) > 1 else next(iter(reliefs), None),
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
