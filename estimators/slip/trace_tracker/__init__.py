"""Slip angle from the curved trace behind a wheel, tracked from image to image: ``ftrace_plus``."""
