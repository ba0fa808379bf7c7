"""Cameras: mounting, calibration, lens, shutter, exposure and noise; stereo cameras on a unit of a combination."""
