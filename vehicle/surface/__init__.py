"""Ground as one object: height, slope, friction and roughness, for the vehicle and the renderer."""

from vehicle.surface.friction import (
    Friction,
    FrictionImage,
    FrictionMap,
    FrictionPatch,
    LineFriction,
    PatchedFriction,
    SplitFriction,
)
from vehicle.surface.ground import (
    PATCH_SPREAD,
    ROAD_CLASSES,
    Gust,
    Potholes,
    Roughness,
    RoughProfile,
    Surface,
    displacement_psd,
    scattered_potholes,
)
from vehicle.surface.relief import PROFILE_WAVES, Beyond, GroundRelief, MeasuredRoad, RoadRelief

__all__ = [
    "PATCH_SPREAD",
    "PROFILE_WAVES",
    "ROAD_CLASSES",
    "Beyond",
    "Friction",
    "FrictionImage",
    "FrictionMap",
    "FrictionPatch",
    "GroundRelief",
    "Gust",
    "LineFriction",
    "MeasuredRoad",
    "PatchedFriction",
    "Potholes",
    "RoadRelief",
    "RoughProfile",
    "Roughness",
    "SplitFriction",
    "Surface",
    "displacement_psd",
    "scattered_potholes",
]
