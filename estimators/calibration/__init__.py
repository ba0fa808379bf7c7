"""Calibration of cameras: from photographs of boards, and online."""
