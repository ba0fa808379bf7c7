"""Faults of sensors and of their transmission: data, fault kinds, and sensors that have them."""
