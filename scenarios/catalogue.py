"""Catalogue of replaceable parts: import paths by name. A user's own part is given by its import path.

Reading the catalogue imports no part. A new part is one module and one line. Each kind states the methods and
declarations of its classes; a class without them is refused before anything of it is called.
"""

import importlib
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any, Final, Protocol, TypeVar

from scenarios.loop_faults.fault import LOOP_FAULTS
from sensors.faults.fault import FAULTS
from vehicle.foundation.own_parts import defined_at, raised_at
from vehicle.foundation.user_file import nearest, shown
from vehicle.option import Option

ContextT = TypeVar("ContextT", contravariant=True)
PartT = TypeVar("PartT", covariant=True)
FMU_READERS: Final = "offtrack.fmu"  # entry points: functions that make the class of a part of an FMU's file


class Catalogue(dict[str, str]):
    """Import paths of one kind of part by name, with what every class of the kind must have."""

    def __init__(
        self,
        paths: Mapping[str, str],
        *,
        methods: tuple[str, ...] = (),
        declares: tuple[str, ...] = (),
        fmu: str = "",
    ) -> None:
        """Paths of classes; ``fmu`` is the entry point of the reader of such a part's FMU."""
        super().__init__(paths)
        self.methods, self.declares, self.fmu = methods, declares, fmu


TRAILER_STEERING: Final = Catalogue(
    {
        "none": "controllers.trailer_steering.signal_laws:Unsteered",
        "combined": "controllers.trailer_steering.lqr:Combined",
        "command_steer": "controllers.trailer_steering.signal_laws:CommandSteer",
        "ct_at": "controllers.trailer_steering.signal_laws:CtAt",
        "lqr": "controllers.trailer_steering.lqr:Lqr",
        "mpc": "controllers.trailer_steering.mpc.law:Mpc",
        "path_preview": "controllers.trailer_steering.path_laws:PathPreview",
        "virtual_driver": "controllers.trailer_steering.path_laws:VirtualDriver",
        "policy": "controllers.trailer_steering.policy:Policy",
    },
    methods=("init", "step"),
    fmu="trailer_steering",
)
ODOMETRY: Final = Catalogue(
    {
        "circular": "estimators.odometry.circular:CircularOdometry",
        "keyframe": "estimators.odometry.keyframe:KeyframeOdometry",
        "viso2": "estimators.odometry.viso2:Viso2Odometry",
    },
    methods=("init", "step"),
)
OFF_TRACKING: Final = Catalogue(
    {
        "truth": "estimators.off_tracking.reference:ReferenceOffTracking",
        "surrogate": "scenarios.assembly.surrogate:SurrogateOffTracking",
        "kinematic": "estimators.off_tracking.kinematic:KinematicOffTracking",
        "viso_ot": "estimators.off_tracking.viso_ot:VisoOt",
        "ground_watching": "estimators.off_tracking.ground_watching:GroundWatching",
        "ground_watching_single": "estimators.off_tracking.ground_watching:SingleGroundWatching",
    },
    methods=("of", "init", "step"),
    declares=("sensor",),
    fmu="off_tracking",
)
SLIP_ESTIMATOR: Final = Catalogue(
    {
        "truth": "estimators.slip.rover_odometry:ReferenceSlip",
        "ftrace": "estimators.slip.wheel_trace.ftrace:FTrace",
        "ftrace_plus": "estimators.slip.trace_tracker.tracker:FTracePlus",
    },
    methods=("of", "init", "step"),
    declares=("sensor",),
)
SENSOR: Final = Catalogue(
    {
        "stereo_camera": "scenarios.assembly.trailer_sensors:StereoCameras",
        "ground_cameras": "scenarios.assembly.trailer_sensors:GroundCameras",
        "reference_pose": "scenarios.assembly.trailer_sensors:ReferencePose",
        "combination_signals": "scenarios.assembly.trailer_sensors:SignalsOfCombination",
    },
    methods=("of",),
)
ROVER_SENSOR: Final = Catalogue(
    {
        "trace_camera": "scenarios.assembly.rover_run:TraceCameraSensor",
        "slip_reading": "scenarios.assembly.rover_run:SlipInstrument",
    },
    methods=("of",),
)
DRIVER: Final = Catalogue(
    {
        "preview": "scenarios.assembly.drivers_and_laws:OnCourse",
        "recorded": "scenarios.assembly.drivers_and_laws:AsRecorded",
    },
    methods=("of",),
    fmu="driver",
)
ROVER_DRIVER: Final = Catalogue(
    {
        "path": "controllers.rover_driver:RoverDriver",
    },
    methods=("of",),
)
PLANT: Final = Catalogue(
    {
        "multibody": "scenarios.assembly.adapters:Multibody",
        "constant_slip": "scenarios.assembly.adapters:ConstantSlip",
    },
    methods=("of",),
    fmu="plant",
)


FAULT: Final = Catalogue({**FAULTS, **LOOP_FAULTS})  # ``sensors.faults.fault.checked_kind`` knows their members


def resolve(key: str, name: str, catalogue: Catalogue, *, in_scenario: bool = True) -> Any:
    """Import the class of a catalogue name or of ``package.module:Name``, also from the working directory.

    Only scenarios need its declarations; on recordings it does without.

    Raises:
        ValueError: one line with the key and the nearest known name, the failed import, or what the class lacks.
    """
    if name.endswith(".fmu"):
        return _of_fmu(key, name, catalogue)
    module_name, colon, attribute = catalogue.get(name, name).partition(":")
    if not colon:
        raise ValueError(f"{key}: unknown name '{shown(name)}'{nearest(name, catalogue)} (or package.module:Name)")
    if not all(part.isidentifier() for part in (*module_name.split("."), attribute)):
        raise ValueError(f"{key} = {shown(name)}: must be package.module:Name")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    module = _module(key, name, module_name)
    part = getattr(module, attribute, None)
    if part is None:
        noun = "module" if getattr(module, "__file__", None) else "folder"
        raise ValueError(f"{key} = {name}: {noun} {module_name} has no '{attribute}'")
    _check_class(key, name, part, catalogue.methods, catalogue.declares if in_scenario else ())
    return part


def _module(key: str, name: str, module_name: str) -> ModuleType:
    try:
        return importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # of a user's module: of any kind
        if isinstance(error, ModuleNotFoundError) and f"{module_name}.".startswith(f"{error.name}."):
            line = f"no module {error.name}; run from its folder or set PYTHONPATH"
        else:
            line = f"importing {module_name} failed: {type(error).__name__}: {error}{raised_at(error)}"
        raise ValueError(f"{key} = {name}: {line}") from error


def _of_fmu(key: str, name: str, catalogue: Catalogue) -> Any:
    """Class of a part that is an FMU: what reads FMUs lies above and is an entry point of offtrack."""
    if not catalogue.fmu:
        raise ValueError(f"{key} = {shown(name)}: an FMU can't be this part")
    readers = entry_points(group=FMU_READERS, name=catalogue.fmu)
    if not readers:
        raise ValueError(f"{key} = {shown(name)}: no reader of FMUs is registered; install offtrack again")
    try:
        return next(iter(readers)).load()(name)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _check_class(key: str, name: str, part: object, methods: tuple[str, ...], declares: tuple[str, ...]) -> None:
    if not inspect.isclass(part):
        raise ValueError(f"{key} = {name}: is no class (see docs/own-parts.md)")
    lacks = [f"the method {method}" for method in methods if not callable(getattr(part, method, None))]
    lacks += [f"the declaration '{declared}'" for declared in declares if not hasattr(part, declared)]
    if lacks:
        raise ValueError(f"{key} = {name}: the class lacks {', '.join(lacks)} (see docs/own-parts.md)")
    options = getattr(part, "options", ()) if declares else ()
    if not isinstance(options, tuple | list) or not all(isinstance(option, Option) for option in options):
        raise ValueError(f"{key} = {name}: 'options' must be a tuple of vehicle.option.Option")


class Part(Protocol[ContextT, PartT]):
    """A class in the catalogue, constructed from its context alone."""

    def of(self, context: ContextT, /) -> PartT:
        """Construct the part for one run.

        Raises:
            ValueError: one line, if the context does not fit.
        """


def constructed(key: str, name: str, construct: Callable[[], PartT]) -> PartT:
    """Construct a part; whatever a user's own class raises is one line.

    Raises:
        ValueError: one line, if its class refuses the context or fails.
    """
    try:
        return construct()
    except Exception as error:
        from sensors.render import RendererUnavailableError

        if ":" not in name or isinstance(error, ValueError | OSError | RendererUnavailableError):
            raise
        place = raised_at(error) or defined_at(_constructor(name))
        raise ValueError(f"{key} = {name}: {type(error).__name__}: {error}{place}") from error


def opened_sensor(name: str, context: Any, catalogue: Catalogue, opened: type[Any]) -> Any:
    """Open a sensor by its name; one without a schedule of its own samples at the rate of the cameras.

    ``opened`` is the class of what is returned: sensor, schedule, and more that its kind of vehicle has.

    Raises:
        ValueError: one line, if there is no such sensor or the context does not fit.
        RendererUnavailableError: one line, if it renders and OpenGL does not work here.
    """
    part = resolve("sensor", name, catalogue)
    made = constructed("sensor", name, lambda: part.of(context))
    result = made if isinstance(made, opened) else opened(sensor=made, schedule=context.schedule)
    check_made("sensor", name, result.sensor, ("sample",))
    return result


def _constructor(name: str) -> object:
    """Constructor of a user's class, which is imported already."""
    module, _, attribute = name.partition(":")
    part = getattr(sys.modules.get(module), attribute, None)
    return getattr(part, "of", None) or getattr(part, "__init__", None)


def check_made(key: str, name: str, made: object, methods: tuple[str, ...]) -> None:
    """Refuse a constructed part that lacks methods.

    Raises:
        ValueError: one line naming them.
    """
    lacks = [method for method in methods if not callable(getattr(made, method, None))]
    if lacks:
        raise ValueError(f"{key} = {name}: made a {type(made).__name__}, which has no method {', '.join(lacks)}")
