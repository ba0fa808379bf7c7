"""Cameras: where they sit, what lens, shutter and sensor make of the light."""
