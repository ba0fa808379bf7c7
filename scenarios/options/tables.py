"""Tables of a scenario: cameras and sensors, ground, wind and traffic, driver and simulated vehicle, and faults.

Each fault is a table, ``{kind = "dropout", amount = 0.1, start = 5.0, duration = 2.0}``, or shorter the text
``dropout:0.1@5+2``: kind, amount, start [s] and duration [s]. All but the kind may be left out. Amounts of several
numbers are separated by commas, several faults in one text by semicolons.

``sensors.faults.fault`` and ``scenarios.loop_faults.fault`` name the kinds. The user's own kind is given by its
import path: ``mymod:Flicker``, with amount and times ``mymod:Flicker:0.2@5+1``. After the first colon, a word is the
class and a number is the amount. A catalogue name before the first colon is always that kind.
"""

import math
import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from scenarios.catalogue import FAULT, resolve
from scenarios.loop_faults.fault import LoopFault, is_loop_kind
from scenarios.options.base import FullPath, PartName
from sensors.camera.rig import UNDISTORTED, Distortion
from sensors.faults.fault import Fault, checked_kind, defaults
from vehicle.combination.variants import NamedChanges
from vehicle.foundation.quantity import Frozen, option, quantity
from vehicle.foundation.user_file import nearest, shown
from vehicle.surface import Beyond

_Angle = Annotated[float, Field(ge=-5.0, le=5.0)]
_Angles = tuple[_Angle, _Angle, _Angle]  # roll about the optical axis, yaw about the camera's y (down), pitch about x


def _angles(meaning: str) -> _Angles:
    straight: _Angles = Field((0.0, 0.0, 0.0), description=meaning, json_schema_extra={"unit": "deg"})
    return straight


class RigOptions(Frozen):
    """The stereo cameras on the trailer (de Saxe & Cebon 2018, section 3.1), without imperfections by default."""

    facing: Literal["rear", "left", "right", "down"] = option("Direction in which the cameras look.", "rear")
    width: int = quantity(1344, "px", 64, 4096, "Image width.")
    height: int = quantity(391, "px", 64, 4096, "Image height.")
    hfov_deg: float = quantity(100.0, "deg", 30.0, 140.0, "Horizontal field of view.")
    camera_height: float = quantity(3.0, "m", 0.5, 6.0, "Height of the cameras above the ground.")
    baseline: float = quantity(0.5, "m", 0.1, 5.0, "Distance between the two cameras.")
    rate_hz: float = quantity(10.0, "Hz", 1.0, 50.0, "Frame rate.")
    latency: float = quantity(0.1, "s", 0.0, 1.0, "Time from exposure to the finished estimate.")
    noise: float = quantity(
        2.0, "grey levels", 0.0, 50.0, "Standard deviation of the image noise that is independent of the light."
    )
    shot_noise: float = quantity(
        0.0, "grey levels", 0.0, 50.0, "Standard deviation of the shot noise of a white pixel."
    )
    distortion: Distortion = option("Coefficients k1, k2, p1, p2, k3 of OpenCV's lens model.", UNDISTORTED)
    calibration: Literal["exact", "boards"] = option(
        "exact: known exactly; boards: calibrated from rendered checkerboards.", "exact"
    )
    misrotation_deg: _Angles = _angles("Roll, yaw, pitch of the right camera since its calibration.")
    twist_deg: _Angles = _angles(
        "Roll, yaw, pitch of the right camera by chassis twist at the rollover limit to the left."
    )
    exposure: Literal["fixed", "auto"] = option("Fixed or automatic exposure.", "fixed")
    exposure_time_constant: float = quantity(0.3, "s", 0.01, 10.0, "Time constant of the automatic exposure.")
    exposure_time_ms: float = quantity(0.0, "ms", 0.0, 50.0, "Exposure time, during which motion blurs the image.")
    rolling_shutter_ms: float = quantity(0.0, "ms", 0.0, 50.0, "Time from the first image row to the last.")
    vignetting: float = quantity(0.0, "-", 0.0, 1.0, "Share of the light lost in the image corners.")
    dirt: float = quantity(0.0, "-", 0.0, 0.9, "Share of the lenses covered by dirt.")
    rain: float = quantity(0.0, "-", 0.0, 0.9, "Share of the lenses covered by drops.")
    self_calibration: bool = option(
        "Estimate the rotation of the right camera while driving, and correct its images.", False
    )
    glare: float = quantity(0.0, "-", 0.0, 5.0, "Glare of the sun on the lenses; 1 is a dusty lens.")


class WorldOptions(Frozen):
    """Scenery along the road, and the light."""

    scenery_density: float = quantity(1.0, "-", 0.0, 2.0, "Density of the scenery; 1 is the reference, 0 bare ground.")
    sun_azimuth_deg: float | None = quantity(
        None, "deg", 0.0, 360.0, "Compass direction of the sun, 270 is west; not given: decided by the seed."
    )
    sun_elevation_deg: float | None = quantity(
        None, "deg", 3.0, 90.0, "Elevation of the sun above the horizon; not given: decided by the seed."
    )
    overcast: bool = option("Overcast sky without direct sun.", False)
    tarmac_width: float | None = quantity(
        None, "m", 9.0, 200.0, "Width of the tarmac around the course; not given: a road."
    )
    tarmac_patches: float = quantity(0.0, "1/100 m2", 0.0, 50.0, "Repaired patches per 100 m2 of tarmac.")
    grain: bool = option("Fields of grain all around.", False)


class GroundRigOptions(Frozen):
    """Two equal cameras under the trailer that look straight down; rate, latency and noise are those of ``rig``."""

    width: int = quantity(480, "px", 160, 2048, "Image width, along the trailer.")
    height: int = quantity(480, "px", 160, 2048, "Image height, across the trailer.")
    hfov_deg: float = quantity(
        70.0, "deg", 20.0, 90.0, "Horizontal field of view; at 1 m height, 70 deg cover 1.4 m of ground."
    )
    camera_height: float = quantity(1.0, "m", 0.5, 1.5, "Height of the cameras above the ground.")
    front: float = quantity(1.5, "m", 0.0, 10.0, "Distance of the front camera behind the hitch.")
    rear: float = quantity(0.5, "m", -5.0, 5.0, "Distance of the rear camera ahead of the follow point.")


SteerGroups = Literal["vehicle", "single", "common_centre"]


class SignalOptions(Frozen):
    """Speed sensor, angle sensors, gyros and accelerometer, for steering laws and no-slip estimators."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of speed, angle and motion sensors; 1: data sheets, 0: exact."
    )


class _PatchOptions(Frozen):
    x: float = quantity(..., "m", -math.inf, math.inf, "Position of its centre in W.")
    y: float = quantity(..., "m", -math.inf, math.inf, "Position of its centre in W.")
    friction: float = quantity(..., "-", 0.05, 1.5, "Friction on the patch.")
    edge: float = quantity(0.0, "m", 0.0, 20.0, "Width of the transition across its outline.")


class CircleOptions(_PatchOptions):
    """A round patch with its own friction."""

    kind: Literal["circle"] = option("Kind of the patch.")
    radius: float = quantity(..., "m", 0.05, 500.0, "Radius.")


class RectangleOptions(_PatchOptions):
    """A rectangular patch with its own friction."""

    kind: Literal["rectangle"] = option("Kind of the patch.")
    length: float = quantity(..., "m", 0.1, 5000.0, "Length.")
    width: float = quantity(..., "m", 0.1, 1000.0, "Width.")
    heading_deg: float = quantity(0.0, "deg", -360.0, 360.0, "Direction of its length from W's x, + left.")


PatchTable = Annotated[CircleOptions | RectangleOptions, Field(discriminator="kind")]


class SurfaceOptions(Frozen):
    """The ground; see vehicle.surface. From bottom to top: friction of both sides, image, patches."""

    friction: float = quantity(0.8, "-", 0.05, 1.5, "Friction of the ground.")
    cross_fall: float = quantity(
        0.0, "-", -0.2, 0.2, "Cross slope, falling to the right or outwards of a roundabout; 0.025 is 2.5 %."
    )
    grade: float = quantity(0.0, "-", -0.2, 0.2, "Slope along W's x; the ground rises.")
    roughness: Literal["none", "A", "B", "C", "D", "E", "F", "G", "H"] = option("Roughness class of ISO 8608.", "none")
    potholes: float = quantity(0.0, "1/100 m", 0.0, 100.0, "Potholes per 100 m of road.")
    crg: FullPath | None = option("OpenCRG file of a measured surface, laid along the course.", None)
    crg_start: float = quantity(
        0.0, "m", -1e4, 3e4, "Where the measured surface begins, along the road from where the guided point starts."
    )
    crg_beyond: Beyond = option(
        "Road before and after the measured surface: level, or the surface mirrored to and fro.", "level"
    )
    friction_left: float | None = quantity(
        None, "-", 0.05, 1.5, "Friction left of the road's middle; not given: surface.friction."
    )
    friction_right: float | None = quantity(
        None, "-", 0.05, 1.5, "Friction right of the road's middle; not given: surface.friction."
    )
    friction_image: FullPath | None = option("Image file whose grey values give the friction.", None)
    friction_image_scale: float = quantity(0.1, "m/px", 0.001, 100.0, "Size of a pixel of the friction image.")
    friction_image_x: float = quantity(0.0, "m", -1e5, 1e5, "Position of its lower left corner in W.")
    friction_image_y: float = quantity(0.0, "m", -1e5, 1e5, "Position of its lower left corner in W.")
    friction_image_black: float = quantity(0.1, "-", 0.05, 1.5, "Friction where the image is black.")
    friction_image_white: float = quantity(0.8, "-", 0.05, 1.5, "Friction where the image is white.")
    patches: tuple[PatchTable, ...] = option("Patches with their own friction; later ones lie on top.", ())
    reformed_width: float = quantity(0.0, "m", 0.0, 5.0, "Width of the strip of ground that each wheel re-forms.")
    reformed_flow: float = quantity(0.0, "-", 0.0, 1.0, "Speed of the re-formed ground, as a share of the vehicle's.")


class WindOptions(Frozen):
    """A gust along W's y on a stretch of W's x axis; none at a speed of 0. The vehicle file needs ``side_wind``."""

    speed: float = quantity(0.0, "m/s", -60.0, 60.0, "Speed of the gust, + towards W's +y, to the left at the start.")
    start: float = quantity(30.0, "m", -1e5, 1e5, "Where the gust begins, along W's x.")
    length: float = quantity(30.0, "m", 0.1, 1e5, "Length of the gust.")
    edge: float = quantity(5.0, "m", 0.1, 1e3, "Length over which it grows and falls.")


class TrafficOptions(Frozen):
    """Vehicles that move around the trailer in its cameras' view."""

    kind: Literal["none", "following", "overtaking", "crossing", "mixed"] = option(
        "Traffic around the trailer; mixed: one vehicle of each kind.", "none"
    )
    gap: float = quantity(3.8, "m", 2.0, 50.0, "Distance from the trailer's rear to a following vehicle, +- 0.4 m.")


def _named_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


TrafficTable = Annotated[TrafficOptions, BeforeValidator(_named_kind)]


class StopTable(Frozen):
    """A stop on the course, with reversing if asked for."""

    station: float = quantity(
        0.0, "m", 1.0, 1e5, "Position of the guided point along the course where the driver stops."
    )
    wait: float = quantity(3.0, "s", 0.0, 60.0, "Duration of the standstill, also after reversing.")
    back: float = quantity(0.0, "m", 0.0, 100.0, "Distance that the driver reverses before continuing.")


class DriverOptions(Frozen):
    """The driver: follows the course at set speed or below a lateral limit, or repeats a recorded drive."""

    kind: PartName | None = option(
        "preview, recorded, package.module:Name or the file of an FMU; not given: recorded if driver.trace is given, "
        "else preview.",
        None,
    )
    parameters: dict[str, bool | int | float | str] = option("Parameters of the user's own driver.", {})
    max_lateral_acceleration: float | None = quantity(
        None, "m/s2", 0.05, 10.0, "Largest lateral acceleration; the driver slows down in turns; not given: no limit."
    )
    stops: tuple[StopTable, ...] = Field(
        default=(), max_length=50, description="Standstills on the course, each with station, wait and back."
    )
    trace: FullPath | None = option(
        "CSV file of a recorded drive with time_s, steer_deg, and speed_kmh or acceleration [m/s2].", None
    )


DriverTable = Annotated[DriverOptions, BeforeValidator(_named_kind)]  # ``driver = "name"`` is short for its kind


class OutsideOptions(Frozen):
    """Demands from outside by ``--udp`` or ``--can``; the scenario's own law or driver stands in where they fail."""

    demands: Literal["none", "trailer", "driver", "both"] = option(
        "Parts that are steered from outside: the trailers' axles, the tractor by its driver, or both.", "none"
    )
    hold: float = quantity(
        0.1, "s", 0.0, 10.0, "Time that a demand holds when no new one comes; then the scenario's own part takes over."
    )
    wait: float = quantity(
        0.0, "s", 0.0, 10.0, "Longest time that the loop waits for the answer to the signals it has just sent."
    )
    record: FullPath | None = option(
        "CSV file of the demands that came in an earlier run, which are repeated; a run directory has one.", None
    )


class PlantOptions(NamedChanges):
    """Changes of the simulated vehicle: named ones, or any number of the vehicle file by its path."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, strict=True)

    kind: str | None = option("multibody, constant_slip or package.module:Name; not given: as the course needs.", None)
    fmu: FullPath | None = option("FMU that simulates the vehicle; the scenario's vehicle stays its data sheet.", None)

    def changes(self) -> dict[str, Any]:
        """Changes of the vehicle that are not at their defaults."""
        fields = type(self).model_fields
        values = {name: value for name, value in self if name not in ("kind", "fmu")}
        return {name: value for name, value in values.items() if name not in fields or value != fields[name].default}


class BrakeOptions(Frozen):
    """Electronic systems of brakes and drive; those not given are as in the vehicle file."""

    abs: bool | None = option("Anti-lock braking; not given: as in the vehicle file.", None)
    traction_control: bool | None = option(
        "Traction control of the driven wheels; not given: as in the vehicle file.", None
    )


_NAMES = "|".join(FAULT)
_TEXT = re.compile(
    rf"(?P<kind>(?:{_NAMES})(?=[:@]|$)|[A-Za-z_][\w.]*(?::[A-Za-z_]\w*)?)"
    r"(:(?P<amount>[^@]*))?(@(?P<start>[^+]*)(\+(?P<duration>.*))?)?"
)


def _numbers(amount: Any) -> Any:
    return (amount,) if isinstance(amount, int | float) else tuple(amount) if isinstance(amount, list) else amount


class FaultOptions(Frozen):
    """One fault."""

    kind: str = option("Fault kind (see offtrack parts fault) or package.module:Name.")
    amount: Annotated[tuple[float, ...], BeforeValidator(_numbers)] = option(
        "Numbers of the fault; not given: the kind's defaults.", ()
    )
    start: float = quantity(0.0, "s", 0.0, 1e5, "Time at which the fault begins.")
    duration: float | None = quantity(None, "s", 0.001, 1e5, "Duration of the fault; not given: to the end.")

    def __str__(self) -> str:
        """The fault as ``--set faults=`` takes it."""
        amount = ",".join(f"{number:g}" for number in self.amount)
        duration = "" if self.duration is None else f"+{self.duration:g}"
        return f"{self.kind}{amount and ':'}{amount}@{self.start:g}{duration}"

    @model_validator(mode="after")
    def _possible(self) -> "FaultOptions":
        self.fault()
        return self

    def fault(self) -> Fault | LoopFault:
        """Build the fault. Of the loop's faults, later numbers of the amount may be left out."""
        _check_name(self.kind)
        part = resolve("kind", self.kind, FAULT)
        if is_loop_kind(part):
            amount = self.amount and (*self.amount, *defaults(part)[len(self.amount) :])
            return LoopFault(name=self.kind, kind=part, amount=amount, start=self.start, duration=self.duration)
        kind = checked_kind(self.kind, part)
        return Fault(name=self.kind, kind=kind, amount=self.amount, start=self.start, duration=self.duration)


def _tables(faults: Any) -> Any:
    """Convert texts to tables; leave anything else to the validation."""
    if isinstance(faults, str):
        return tuple(_table(text.strip()) for text in faults.split(";") if text.strip() not in ("", "none"))
    if isinstance(faults, list | tuple):
        return tuple(_table(fault) if isinstance(fault, str) else fault for fault in faults)
    return faults


def _table(text: str) -> dict[str, Any]:
    match = _TEXT.fullmatch(text)
    if match is None:
        raise ValueError(f"fault '{shown(text)}' must be written as kind:amount@start+duration")
    _check_name(match["kind"])
    table: dict[str, Any] = {"kind": match["kind"]}
    if match["amount"]:
        table["amount"] = tuple(map(_number, match["amount"].split(",")))
    return table | {key: _number(match[key]) for key in ("start", "duration") if match[key]}


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text  # refused by the validation, which names the key


def _check_name(kind: str) -> None:
    if kind not in FAULT and ":" not in kind:
        raise ValueError(f"unknown fault '{shown(kind)}'{nearest(kind, FAULT)} (or package.module:Name)")


Faults = Annotated[tuple[FaultOptions, ...], BeforeValidator(_tables)]
