"""Laws, drivers and the camera loop out: small native FMUs in front of a Python process that computes."""
