"""Options of the ground, the wind, and the traffic."""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from scenarios.options.base import FullPath
from vehicle.foundation.quantity import Frozen, option, quantity
from vehicle.surface import Beyond


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


def _table(traffic: Any) -> Any:
    return {"kind": traffic} if isinstance(traffic, str) else traffic


TrafficTable = Annotated[TrafficOptions, BeforeValidator(_table)]
