"""Instruments that are no cameras: encoders, gyros, compass, reference units."""
