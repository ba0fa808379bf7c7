"""Ground as one object: height, slope, friction and roughness, for the vehicle and the renderer."""

from vehicle.surface.friction import Friction, FrictionImage, FrictionMap, SplitFriction
from vehicle.surface.ground import Surface
from vehicle.surface.patches import PatchedFriction, circle, rectangle
from vehicle.surface.potholes import Potholes, scattered_potholes
from vehicle.surface.roughness import ROAD_CLASSES, Roughness, RoughProfile, displacement_psd

__all__ = [
    "ROAD_CLASSES",
    "Friction",
    "FrictionImage",
    "FrictionMap",
    "PatchedFriction",
    "Potholes",
    "RoughProfile",
    "Roughness",
    "SplitFriction",
    "Surface",
    "circle",
    "displacement_psd",
    "rectangle",
    "scattered_potholes",
]
