"""Estimates in, commands out: pure init/step."""
