"""Slip angle from the curved trace behind a wheel, tracked from picture to picture: ``ftrace_plus``."""
