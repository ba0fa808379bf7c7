"""Cameras of the ground-watching system."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from scenarios.assembly.mount import Cameras, MountContext, OpenedSensor
from sensors.camera.rig import ground_watching_pair
from sensors.camera.stereo_camera import PairSource, StereoCamera
from sensors.messages import StereoFrame
from sensors.world.reformed_ground import ReformedGround
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray


class GroundCameras:
    """Two cameras under a trailer that look straight down; its wheels may re-form the ground."""

    sends: ClassVar = StereoFrame

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Cameras under one trailer.

        Raises:
            ValueError: if the rear camera would not be behind the front one.
            RendererUnavailableError: if OpenGL does not work here.
        """
        options, ground = context.scenario.ground_rig, context.scenario.surface
        calibration = ground_watching_pair(
            options.width,
            options.height,
            math.radians(options.hfov_deg),
            front_x=-options.front,
            rear_x=options.rear - context.trailer.follow_distance,
            z=options.camera_height,
        )
        renderer = context.views.seen_by(calibration)
        source: PairSource = renderer
        if ground.reformed_width > 0.0:
            wheels, width = wheels_near(context.vehicle, context.unit), ground.reformed_width
            source = ReformedGround(renderer, context.surface, wheels, width=width, flow=ground.reformed_flow)
        camera = StereoCamera(
            renderer=source,
            unit=context.unit,
            noise_std=context.scenario.rig.noise,
            rng=context.stream("camera noise"),
            keep_colour=context.keep_colour,
        )
        cameras = Cameras(calibrated=calibration, calibration=calibration, epipolar=False)
        return OpenedSensor(sensor=camera, schedule=context.schedule, cameras=cameras)


def wheels_near(vehicle: Vehicle, unit: int) -> tuple[FloatArray, FloatArray]:
    """Positions of wheels in the unit's frame, (n, 2) [m] each: the rearmost of the unit ahead, and its own.

    The former are close to the hitch, so that the articulation hardly moves them.
    """
    own, leader = vehicle.units[unit], vehicle.units[unit - 1]
    last = min(leader.axles, key=lambda axle: axle.x)
    ahead = 0.0 if leader.hitch_x is None else last.x - leader.hitch_x
    return _both_sides([(ahead, last.track)]), _both_sides([(axle.x, axle.track) for axle in own.axles])


def _both_sides(axles: list[tuple[float, float]]) -> FloatArray:
    return np.array([(x, side * 0.5 * track) for x, track in axles for side in (1.0, -1.0)])
