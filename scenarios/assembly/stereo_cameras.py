"""The stereo cameras of a trailer, with lenses and calibration as in the scenario."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Generic, TypeVar

import numpy as np

from estimators.calibration.rectification import Rectifier
from estimators.protocol import Estimator
from scenarios.assembly.adapters import rig_on
from scenarios.assembly.board_calibration import calibrated_with_boards
from scenarios.assembly.mount import Cameras, MountContext, OpenedSensor
from scenarios.options.rig import RigOptions
from sensors.camera.image_formation import AutoExposure
from sensors.camera.lens import UNDISTORTED, mount_rotation
from sensors.camera.raw_camera import Imperfections, RawStereoCamera, pinholes_for
from sensors.camera.rig import StereoCalibration
from sensors.camera.stereo_camera import StereoCamera
from sensors.messages import StereoFrame, TrailerView
from vehicle.closing import close_part

MemoryT = TypeVar("MemoryT")
EstimateT = TypeVar("EstimateT")


class Rectified(Generic[MemoryT, EstimateT]):
    """An estimator that receives raw stereo frames rectified."""

    def __init__(
        self, estimator: Estimator[MemoryT, StereoFrame | TrailerView, EstimateT], rectifier: Rectifier
    ) -> None:
        self._estimator, self._rectifier = estimator, rectifier

    def init(self) -> MemoryT:
        """Memory before the first frame."""
        return self._estimator.init()

    def step(self, memory: MemoryT, message: StereoFrame | TrailerView) -> tuple[MemoryT, EstimateT | None]:
        """Step of the estimator with the rectified frame."""
        if isinstance(message, StereoFrame):
            return self._estimator.step(memory, self._rectifier.step(message))
        if message.frame is not None:
            message = replace(message, frame=self._rectifier.step(message.frame))
        return self._estimator.step(memory, message)

    def close(self) -> None:
        """Close the estimator."""
        close_part(self._estimator)


class StereoCameras:
    """The scenario's stereo cameras: ideal pinholes, or cameras with the imperfections of the options.

    The calibration includes the lenses but not the later bending of the mount.
    """

    sends: ClassVar = StereoFrame

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Cameras on one trailer.

        Raises:
            ValueError: if the lenses are not possible or cannot be calibrated.
            RendererUnavailableError: if OpenGL does not work here.
        """
        options, views = context.scenario.rig, context.views
        rig = rig_on(context.vehicle.units[context.unit], context.trailer, options)
        noise = context.stream("camera noise")
        imperfections = _imperfections(options)
        straight, exact = not any(options.misrotation_deg), options.calibration == "exact"
        undistorted = options.distortion == UNDISTORTED
        if straight and exact and undistorted and replace(imperfections, read_noise=0.0) == Imperfections():
            return _pinholes(context, rig.calibration(), noise)
        true = rig.raw(options.distortion, mount_rotation(*np.radians(options.misrotation_deg)))
        calibrated = rig.raw(options.distortion)
        if not exact:
            board_noise = math.hypot(options.noise, math.sqrt(0.5) * options.shot_noise)  # half of a board is white
            boards = context.stream("calibration boards")
            calibrated = calibrated_with_boards(
                calibrated, noise_std=board_noise, rng=boards, progress=context.progress
            ).rig
        rectifier = None if exact and undistorted else Rectifier(calibrated)
        renderer, light = views.seen_by(pinholes_for(true, imperfections)), views.world.light
        camera = RawStereoCamera(
            renderer=renderer,
            rig=true,
            imperfections=imperfections,
            sun=None if light.overcast else light.direction,
            unit=context.unit,
            rng=noise,
            keep_colour=context.keep_colour,
        )
        cameras = Cameras(
            calibrated=calibrated if rectifier else rig.calibration(),
            calibration=rectifier.calibration if rectifier else rig.calibration(),
            rectifier=rectifier,
        )
        return OpenedSensor(sensor=views.amid(camera, renderer), schedule=context.schedule, cameras=cameras)


def _pinholes(context: MountContext, calibration: StereoCalibration, noise: np.random.Generator) -> OpenedSensor:
    renderer = context.views.seen_by(calibration)
    camera = StereoCamera(
        renderer=renderer,
        unit=context.unit,
        noise_std=context.scenario.rig.noise,
        rng=noise,
        keep_colour=context.keep_colour,
    )
    return OpenedSensor(
        sensor=context.views.amid(camera, renderer),
        schedule=context.schedule,
        cameras=Cameras(calibrated=calibration, calibration=calibration),
    )


def _imperfections(options: RigOptions) -> Imperfections:
    roll, yaw, pitch = (math.radians(angle) for angle in options.twist_deg)
    automatic = AutoExposure(time_constant=options.exposure_time_constant)
    return Imperfections(
        twist=(roll, yaw, pitch),
        read_noise=options.noise,
        shot_noise=options.shot_noise,
        exposure_time=1e-3 * options.exposure_time_ms,
        rolling_shutter=1e-3 * options.rolling_shutter_ms,
        auto_exposure=automatic if options.exposure == "auto" else None,
        vignetting=options.vignetting,
        dirt=options.dirt,
        rain=options.rain,
        glare=options.glare,
    )
