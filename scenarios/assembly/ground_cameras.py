"""The cameras of the ground-watching system of a run."""

from __future__ import annotations

import math

import numpy as np

from controllers.trailer import TrailerGeometry
from scenarios.assembly.stereo_cameras import Cameras, Views
from scenarios.options.scenario import Scenario
from sensors.camera.ground_rig import GroundRig
from sensors.camera.stereo_camera import PairSource, StereoCamera
from sensors.world.reformed_ground import ReformedGround
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray
from vehicle.surface import Surface


def opened_ground_cameras(
    scenario: Scenario,
    views: Views,
    surface: Surface,
    vehicle: Vehicle,
    trailer: TrailerGeometry,
    *,
    unit: int,
    rng: np.random.Generator,
    keep_colour: bool,
) -> Cameras:
    """The cameras under a unit of the vehicle, over ground that its wheels may re-form.

    Raises:
        ValueError: if the rear camera would not be behind the front one.
        RendererUnavailableError: if OpenGL does not work here.
    """
    options, ground = scenario.ground_rig, scenario.surface
    rig = GroundRig(
        width=options.width,
        height=options.height,
        hfov=math.radians(options.hfov_deg),
        front_x=-options.front,
        rear_x=options.rear - trailer.follow_distance,
        z=options.camera_height,
    )
    calibration = rig.calibration()
    renderer = views.seen_by(calibration)
    source: PairSource = renderer
    if ground.reformed_width > 0.0:
        wheels = wheels_near(vehicle, unit)
        source = ReformedGround(renderer, surface, wheels, width=ground.reformed_width, flow=ground.reformed_flow)
    camera = StereoCamera(renderer=source, unit=unit, noise_std=scenario.rig.noise, rng=rng, keep_colour=keep_colour)
    return Cameras(calibrated=calibration, calibration=calibration, camera=camera, renderer=renderer, rectifier=None)


def wheels_near(vehicle: Vehicle, unit: int) -> tuple[FloatArray, FloatArray]:
    """Where wheels roll, each (n, 2) [m] in the unit's frame: the rearmost of the unit in front of it, and its own.

    The former run close to the hitch, so that the articulation hardly moves them.
    """
    own, leader = vehicle.units[unit], vehicle.units[unit - 1]
    last = min(leader.axles, key=lambda axle: axle.x)
    ahead = 0.0 if leader.hitch_x is None else last.x - leader.hitch_x
    return _both_sides([(ahead, last.track)]), _both_sides([(axle.x, axle.track) for axle in own.axles])


def _both_sides(axles: list[tuple[float, float]]) -> FloatArray:
    return np.array([(x, side * 0.5 * track) for x, track in axles for side in (1.0, -1.0)])
