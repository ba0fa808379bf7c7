"""Faults of sensors and their wires."""
