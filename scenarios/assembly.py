"""From a scenario to the parts of its run: everything is constructed, and refused if need be, before anything moves."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import Any, Protocol

from controllers.driver import PreviewDriver, TractorGeometry
from controllers.trailer import TrailerGeometry, TrailerSteering
from scenarios import courses
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, TRAILER_STEERING, resolve
from scenarios.courses import Course
from scenarios.randomness import stream
from scenarios.scenario import ConstantSlipOptions, Parameter, RoundaboutOptions, Scenario
from sensors.messages import BodyPose, StereoFrame
from sensors.navigation import ExactPose
from sensors.render import StereoRenderer
from sensors.rig import StereoCalibration, StereoRig
from sensors.stereo_camera import StereoCamera
from sensors.world import build_world
from vehicle.clock import Schedule
from vehicle.description import Unit, Vehicle, load_vehicle
from vehicle.frames import FloatArray, Pose2
from vehicle.parameter_file import nearest
from vehicle.plant import Plant, VehicleCommand
from vehicle.prescribed import ConstantSlipPlant
from vehicle.surface import Surface
from vehicle.truth import Truth

_SCENERY_CLEARANCE = 8.0  # trailers cut in by several metres, and nothing solid may stand there [m]


class Motive(Protocol):
    """Whatever moves the vehicle: a plant with tyres, or a prescribed motion."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray: ...

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray: ...

    def observe(self, state: FloatArray, tick: int) -> Truth: ...


class PoseSensor(Protocol):
    """What the off-tracking is estimated from: a stereo camera or a reference unit."""

    def sample(self, truth: Truth) -> StereoFrame | BodyPose: ...


class OffTrackingSource(Protocol):
    """An off-tracking estimator, with the odometry (if any) that feeds it."""

    def init(self) -> Any: ...

    def step(self, memory: Any, message: Any) -> tuple[Any, Any]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembly:
    """The parts of one run."""

    scenario: Scenario
    seed: int
    vehicle: Vehicle
    trailer_unit: int  # which unit is watched and steered
    trailer: TrailerGeometry
    course: Course
    motive: Motive
    driver: PreviewDriver | None  # None: the motion is prescribed
    trailer_steering: TrailerSteering[Any]
    schedule: Schedule  # of the camera, or of the reference unit in its place
    sensor: PoseSensor
    source: OffTrackingSource
    calibration: StereoCalibration | None  # of the cameras, where there are any
    camera: StereoCamera | None
    renderer: StereoRenderer | None


def assemble(scenario: Scenario, seed: int, *, keep_colour: bool = False, record: bool = False) -> Assembly:
    """The parts of the scenario's run with this seed.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    vehicle = load_vehicle(scenario.vehicle)
    trailer_unit = _watched(vehicle, scenario)
    trailer = trailer_geometry(vehicle, trailer_unit)
    course = _course(scenario, vehicle)
    surface = Surface(
        friction=scenario.surface.friction,
        cross_fall=scenario.surface.cross_fall,
        grade=scenario.surface.grade,
        centre=course.surface_centre,
    )
    prescribed = isinstance(scenario.course, ConstantSlipOptions)
    if prescribed and scenario.trailer_steering != "none":
        raise ValueError(
            f"trailer_steering = {scenario.trailer_steering}: the trailer of {scenario.name} is dragged at a constant "
            "slip angle and can not be steered; use trailer_steering=none"
        )
    steering = _constructed("trailer_steering", scenario.trailer_steering, TRAILER_STEERING, trailer, scenario.steering)
    estimator = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING)
    odometry = resolve("odometry", scenario.odometry, ODOMETRY)
    schedule = Schedule.at_rate(scenario.rig.rate_hz, latency=scenario.rig.latency, name="rig.rate_hz")
    motive = (
        ConstantSlipPlant(
            vehicle,
            surface,
            unit=trailer_unit,
            slip_angle=math.radians(scenario.course.slip_angle_deg),
            speed=scenario.speed,
        )
        if isinstance(scenario.course, ConstantSlipOptions)
        else Plant(vehicle, surface)
    )
    driver = None if prescribed else PreviewDriver(_tractor_geometry(vehicle, course), course.path, scenario.speed)

    sees = scenario.off_tracking != "truth"
    calibration = renderer = camera = None
    sensor: PoseSensor = ExactPose(trailer_unit)
    if sees or record:
        calibration = _rig(scenario, vehicle.units[trailer_unit], trailer).calibration()
        world = build_world(
            rng=stream(seed, "world"),
            centreline=course.centreline,
            road_half_width=course.road_half_width,
            surface=surface,
            scenery_density=scenario.world.scenery_density,
            clearance=_SCENERY_CLEARANCE,
        )
        renderer = StereoRenderer(world, calibration)
        camera = StereoCamera(
            renderer=renderer,
            unit=trailer_unit,
            noise_std=scenario.rig.noise,
            rng=stream(seed, "camera noise"),
            keep_colour=keep_colour,
        )
    if sees and camera and calibration:
        sensor, source = camera, estimator(calibration, trailer.follow_distance, odometry(calibration))
    else:
        source = estimator(trailer.follow_distance)
    return Assembly(
        scenario=scenario,
        seed=seed,
        vehicle=vehicle,
        trailer_unit=trailer_unit,
        trailer=trailer,
        course=course,
        motive=motive,
        driver=driver,
        trailer_steering=steering,
        schedule=schedule,
        sensor=sensor,
        source=source,
        calibration=calibration,
        camera=camera,
        renderer=renderer,
    )


def trailer_geometry(vehicle: Vehicle, unit: int) -> TrailerGeometry:
    """The data sheet of one towed unit for its steering controller.

    Raises:
        ValueError: if the unit has no follow point.
    """
    trailer = vehicle.units[unit]
    if trailer.follow_x is None:
        raise ValueError(
            f"vehicle {vehicle.name}: unit '{trailer.name}' needs follow_x [m], the point that is to follow"
        )
    steering = trailer.steering
    return TrailerGeometry(
        follow_distance=-trailer.follow_x,
        axle_distances=tuple(-axle.x for axle in trailer.axles),
        steered=tuple(axle.steered for axle in trailer.axles),
        max_steer=steering.limit if steering else 0.0,
        max_steer_rate=steering.rate_limit if steering else 0.0,
        actuator_lag=steering.lag if steering else 0.0,
    )


def _watched(vehicle: Vehicle, scenario: Scenario) -> int:
    if len(vehicle.units) < 2:
        raise ValueError(f"vehicle {vehicle.name} tows nothing: scenario {scenario.name} needs a trailer")
    return len(vehicle.units) - 1


def _course(scenario: Scenario, vehicle: Vehicle) -> Course:
    options, tractor = scenario.course, vehicle.units[0]
    if isinstance(options, ConstantSlipOptions):
        return courses.straight(front_x=tractor.front_x, length=options.length)
    if isinstance(options, RoundaboutOptions):
        return courses.roundabout(
            front_x=tractor.front_x,
            width=tractor.width,
            direction=options.direction,
            radius=options.radius,
            turn=math.radians(options.turn_deg),
            entry=options.entry,
            exit=options.exit,
        )
    return courses.figure_of_eight(
        front_x=tractor.front_x, width=tractor.width, radius=options.radius, entry=options.entry, exit=options.exit
    )


def _tractor_geometry(vehicle: Vehicle, course: Course) -> TractorGeometry:
    tractor = vehicle.units[0]
    if tractor.steering is None:
        raise ValueError(f"vehicle {vehicle.name}: the tractor has no steering")
    return TractorGeometry(
        wheelbase=tractor.steered_axles[0].x,  # frame T has its origin at the rear axle
        x_ref=course.reference[0],
        y_ref=course.reference[1],
        max_steer=tractor.steering.limit,
        max_steer_rate=tractor.steering.rate_limit,
        actuator_lag=tractor.steering.lag,
    )


def _rig(scenario: Scenario, trailer: Unit, geometry: TrailerGeometry) -> StereoRig:
    """Rear-facing cameras sit over the follow point; side-facing ones on their edge of the roof, half way along."""
    options = scenario.rig
    x, y = {
        "rear": (-geometry.follow_distance, 0.0),
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


def _constructed(
    key: str, name: str, catalogue: dict[str, str], trailer: TrailerGeometry, parameters: dict[str, Parameter]
) -> Any:
    """The part of that name, given its own parameters by keyword; one it does not have is refused."""
    part = resolve(key, name, catalogue)
    known = [p.name for p in inspect.signature(part).parameters.values() if p.kind is not p.VAR_KEYWORD][1:]
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"steering.{parameter}: {name} has no such parameter{nearest(parameter, known)}")
    try:
        return part(trailer, **parameters)
    except TypeError as error:
        raise ValueError(f"{key} = {name}: can not be constructed as {part.__name__}(trailer, ...): {error}") from error
