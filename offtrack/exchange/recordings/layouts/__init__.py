"""Layouts of recordings: a file for each, found by looking at what a path holds."""
