"""Stereo odometries: the motion of a camera pair from its images."""
