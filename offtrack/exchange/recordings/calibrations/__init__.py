"""Calibrations of raw stereo pairs as other programs write them, a file for each."""
