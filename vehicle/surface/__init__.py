"""Ground as one object: height, slope, friction and roughness, for the vehicle and the renderer."""

from vehicle.surface.friction import (
    Friction,
    FrictionImage,
    FrictionMap,
    LineFriction,
    PatchedFriction,
    SplitFriction,
    circle,
    rectangle,
)
from vehicle.surface.ground import Surface
from vehicle.surface.gust import Gust
from vehicle.surface.relief import RoadRelief
from vehicle.surface.roughness import (
    ROAD_CLASSES,
    Potholes,
    Roughness,
    RoughProfile,
    displacement_psd,
    scattered_potholes,
)

__all__ = [
    "ROAD_CLASSES",
    "Friction",
    "FrictionImage",
    "FrictionMap",
    "Gust",
    "LineFriction",
    "PatchedFriction",
    "Potholes",
    "RoadRelief",
    "RoughProfile",
    "Roughness",
    "SplitFriction",
    "Surface",
    "circle",
    "displacement_psd",
    "rectangle",
    "scattered_potholes",
]
