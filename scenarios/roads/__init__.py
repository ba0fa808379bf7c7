"""Courses from files: points of a path, and OpenDRIVE roads."""
