"""Instruments other than cameras: encoders, gyros, compass, laser tracker, reference units."""
