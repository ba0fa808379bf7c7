"""Catalogue of replaceable parts: import paths by name. A user's own part is given by its import path.

Reading the catalogue imports no part. A new part is one module and one line.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final, Protocol, TypeVar

from vehicle.parameter_file import nearest

ContextT = TypeVar("ContextT", contravariant=True)
PartT = TypeVar("PartT", covariant=True)

TRAILER_STEERING: Final = {
    "none": "controllers.trailer_steering.unsteered:Unsteered",
    "combined": "controllers.trailer_steering.combined:Combined",
    "command_steer": "controllers.trailer_steering.command_steer:CommandSteer",
    "ct_at": "controllers.trailer_steering.ct_at:CtAt",
    "lqr": "controllers.trailer_steering.lqr:Lqr",
    "mpc": "controllers.trailer_steering.mpc.law:Mpc",
    "path_preview": "controllers.trailer_steering.path_preview:PathPreview",
    "virtual_driver": "controllers.trailer_steering.virtual_driver:VirtualDriver",
    "policy": "controllers.trailer_steering.policy:Policy",
}
ODOMETRY: Final = {
    "circular": "estimators.odometry.circular:CircularOdometry",
    "keyframe": "estimators.odometry.keyframe:KeyframeOdometry",
    "viso2": "estimators.odometry.viso2:Viso2Odometry",
}
OFF_TRACKING: Final = {
    "truth": "estimators.off_tracking.reference:ReferenceOffTracking",
    "surrogate": "scenarios.environments.surrogate_estimator:SurrogateOffTracking",
    "kinematic": "estimators.off_tracking.kinematic:KinematicOffTracking",
    "viso_ot": "estimators.off_tracking.viso_ot:VisoOt",
    "ground_watching": "estimators.off_tracking.ground_watching:GroundWatching",
    "ground_watching_single": "estimators.off_tracking.ground_watching:SingleGroundWatching",
}
SLIP_ESTIMATOR: Final = {
    "truth": "estimators.slip.reference:ReferenceSlip",
    "ftrace": "estimators.slip.wheel_trace.ftrace:FTrace",
    "ftrace_plus": "estimators.slip.trace_tracker.tracker:FTracePlus",
}
SENSOR: Final = {
    "stereo_camera": "scenarios.assembly.stereo_cameras:StereoCameras",
    "ground_cameras": "scenarios.assembly.ground_cameras:GroundCameras",
    "reference_pose": "scenarios.assembly.mount:ReferencePose",
    "combination_signals": "scenarios.assembly.mount:SignalsOfCombination",
}
ROVER_SENSOR: Final = {
    "trace_camera": "scenarios.assembly.rover_sensors:TraceCameraSensor",
    "slip_reading": "scenarios.assembly.rover_sensors:SlipInstrument",
}
DRIVER: Final = {
    "preview": "scenarios.assembly.drivers:OnCourse",
    "recorded": "scenarios.assembly.drivers:AsRecorded",
}
ROVER_DRIVER: Final = {
    "path": "controllers.rover_driver:RoverDriver",
}
PLANT: Final = {
    "multibody": "scenarios.assembly.plants:Multibody",
    "constant_slip": "scenarios.assembly.plants:ConstantSlip",
}


def resolve(key: str, name: str, catalogue: Mapping[str, str]) -> Any:
    """Import the class of a catalogue name or of ``package.module:Name``, also from the working directory.

    Raises:
        ValueError: one line with the key and the nearest known name, or the failed import.
    """
    path = catalogue.get(name, name)
    module_name, colon, attribute = path.partition(":")
    if not colon:
        raise ValueError(f"{key}: unknown name '{name}'{nearest(name, tuple(catalogue))} (or package.module:Name)")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        return getattr(importlib.import_module(module_name), attribute)
    except ModuleNotFoundError as error:
        raise ValueError(f"{key} = {name}: no module {error.name}; run from its folder or set PYTHONPATH") from error
    except AttributeError as error:
        raise ValueError(f"{key} = {name}: module {module_name} has no '{attribute}'") from error


class Part(Protocol[ContextT, PartT]):
    """A class in the catalogue, constructed from its context alone."""

    def of(self, context: ContextT, /) -> PartT:
        """Construct the part for one run.

        Raises:
            ValueError: one line, if the context does not fit.
        """


def constructed(key: str, name: str, part: Part[ContextT, PartT], context: ContextT) -> PartT:
    """Construct a part from its context.

    Raises:
        ValueError: one line, if its class has no ``of(context)`` or refuses the context.
    """
    if not callable(getattr(part, "of", None)):
        raise ValueError(f"{key} = {name}: the class needs a class method of(context)")
    return part.of(context)


def check_declared(key: str, name: str, part: object, attributes: Sequence[str]) -> None:
    """Refuse a class that lacks required attributes.

    Raises:
        ValueError: one line naming the class and the attribute.
    """
    for attribute in attributes:
        if not hasattr(part, attribute):
            raise ValueError(f"{key} = {name}: the class must declare '{attribute}' (see docs/own-parts.md)")
