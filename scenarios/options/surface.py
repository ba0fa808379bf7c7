"""The ground as a scenario file describes it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from scenarios.options.base import Options, quantity


class _PatchOptions(Options):
    x: float = Field(json_schema_extra={"unit": "m"})  # W of its middle
    y: float = Field(json_schema_extra={"unit": "m"})
    friction: float = Field(ge=0.05, le=1.5)
    edge: float = quantity(0.0, "m", ge=0.0, le=20.0)  # width of the transition across its outline


class CircleOptions(_PatchOptions):
    """A round patch of another friction."""

    kind: Literal["circle"]
    radius: float = Field(ge=0.05, le=500.0, json_schema_extra={"unit": "m"})


class RectangleOptions(_PatchOptions):
    """A rectangular patch of another friction."""

    kind: Literal["rectangle"]
    length: float = Field(ge=0.1, le=5000.0, json_schema_extra={"unit": "m"})
    width: float = Field(ge=0.1, le=1000.0, json_schema_extra={"unit": "m"})
    heading_deg: float = quantity(0.0, "deg", ge=-360.0, le=360.0)  # of its length, from W's x


PATCHES = (CircleOptions, RectangleOptions)
PatchTable = Annotated[CircleOptions | RectangleOptions, Field(discriminator="kind")]


class SurfaceOptions(Options):
    """The ground; see vehicle.surface. What is named later lies on top: both sides, an image, patches."""

    friction: float = quantity(0.8, "-", ge=0.05, le=1.5)
    cross_fall: float = quantity(0.0, "-", ge=-0.2, le=0.2)  # a slope: 0.025 is 2.5 %
    grade: float = quantity(0.0, "-", ge=-0.2, le=0.2)
    roughness: Literal["none", "A", "B", "C", "D", "E", "F", "G", "H"] = "none"  # class of ISO 8608
    potholes: float = quantity(0.0, "1/100 m", ge=0.0, le=100.0)
    friction_left: float | None = quantity(None, "-", ge=0.05, le=1.5)  # to the left of the road's middle
    friction_right: float | None = quantity(None, "-", ge=0.05, le=1.5)
    friction_image: str | None = None  # a file whose grey values are frictions
    friction_image_scale: float = quantity(0.1, "m/px", ge=0.001, le=100.0)
    friction_image_x: float = quantity(0.0, "m", ge=-1e5, le=1e5)  # W of its lower left corner
    friction_image_y: float = quantity(0.0, "m", ge=-1e5, le=1e5)
    friction_image_black: float = quantity(0.1, "-", ge=0.05, le=1.5)  # friction where it is black
    friction_image_white: float = quantity(0.8, "-", ge=0.05, le=1.5)
    patches: tuple[PatchTable, ...] = ()  # later ones on top
    reformed_width: float = quantity(0.0, "m", ge=0.0, le=5.0)  # strip along a wheel's track that it leaves different
    reformed_flow: float = quantity(0.0, "-", ge=0.0, le=1.0)  # share of the vehicle's velocity that this moves at

    @field_validator("friction_image")
    @classmethod
    def _full_path(cls, path: str | None) -> str | None:
        return None if path is None else str(Path(path).resolve())  # the resolved scenario runs from any folder
