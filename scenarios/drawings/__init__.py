"""Drawings of drives for CAD: swept path, vehicle outlines, paths and road, in the frame of the course in metres."""
