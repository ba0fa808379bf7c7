"""Faults of the loop beyond its sensors: messages to laws and actuators, steering actuators, brakes."""
