"""The rendered world of a run, and its renderers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from controllers.trailer import TrailerGeometry
from scenarios.courses import Course
from scenarios.options.rig import WorldOptions
from scenarios.options.traffic import TrafficOptions
from sensors.camera.rig import StereoCalibration
from sensors.render import StereoRenderer
from sensors.world.ground import ground_height
from sensors.world.traffic import InTraffic, StereoSampler, Traffic, populated
from sensors.world.world import World, build_world
from vehicle.combination.unit import Unit
from vehicle.surface import Surface

_SCENERY_CLEARANCE = 8.0  # distance of scenery from the course; trailers cut in by several metres [m]


class Views:
    """One world and one renderer for the cameras of all trailers, built when the first is opened."""

    def __init__(self, built: Callable[[], World], traffic: Traffic | None = None) -> None:
        self._built = built
        self._traffic = traffic
        self._world: World | None = None
        self._renderer: StereoRenderer | None = None

    @property
    def world(self) -> World:
        """The world of the run."""
        if self._world is None:
            self._world = self._built() if self._traffic is None else populated(self._built(), self._traffic)
        return self._world

    def amid(self, camera: StereoSampler, renderer: StereoRenderer) -> StereoSampler:
        """The camera, with moving traffic in its view if there is any."""
        return camera if self._traffic is None else InTraffic(camera, renderer, self._traffic)

    def seen_by(self, calibration: StereoCalibration) -> StereoRenderer:
        """A renderer for the cameras of this calibration; the first one owns OpenGL's context.

        Raises:
            RendererUnavailableError: if OpenGL does not work here.
        """
        if self._renderer is None:
            self._renderer = StereoRenderer(self.world, calibration)
            return self._renderer
        return self._renderer.on(calibration)

    @property
    def renderer_name(self) -> str:
        """Name of OpenGL's renderer; "none" if nothing was rendered."""
        return "none" if self._renderer is None else self._renderer.name

    def close(self) -> None:
        """Close the renderer."""
        if self._renderer is not None:
            self._renderer.close()


def traffic_around(
    options: TrafficOptions, trailer: Unit, geometry: TrailerGeometry, surface: Surface, rng: np.random.Generator
) -> Traffic | None:
    """The traffic around a combination whose last unit is the ``trailer``; None if there is none."""
    if options.kind == "none":
        return None
    return Traffic(
        rng,
        kind=options.kind,
        gap=options.gap,
        follow_distance=geometry.follow_distance,
        half_width=0.5 * trailer.width,
        height=lambda xy: ground_height(surface, xy),
    )


def built_world(options: WorldOptions, course: Course, surface: Surface, rng: np.random.Generator) -> World:
    """The world around a course."""
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    half_width = course.road_half_width if options.tarmac_width is None else 0.5 * options.tarmac_width
    return build_world(
        rng=rng,
        centreline=course.centreline,
        road_half_width=half_width,
        lane_lines=course.lane_lines if options.tarmac_width is None else None,
        surface=surface,
        scenery_density=options.scenery_density,
        clearance=max(_SCENERY_CLEARANCE, float(np.max(half_width))),
        sun_azimuth=None if azimuth is None else math.radians(azimuth),
        sun_elevation=None if elevation is None else math.radians(elevation),
        overcast=options.overcast,
        grain=options.grain,
        tarmac_patches=options.tarmac_patches,
    )
