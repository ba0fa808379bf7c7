"""Backwards along a path: what a driver knows of his combination, the way he means to take, and how he steers it."""
