"""Tyres: laws of the steady force, one a module, and the elastic carcass through which all of them act."""

from vehicle.tyres.tyre import ROLLING_SPEED_FLOOR, Contact, Grip, Num, Planar, Tyre, carcass, contact, rolling_speed

__all__ = ["ROLLING_SPEED_FLOOR", "Contact", "Grip", "Num", "Planar", "Tyre", "carcass", "contact", "rolling_speed"]
