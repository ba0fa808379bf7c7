"""Runs of a rover: its scenario, the parts of its loop, and what a run leaves behind."""
