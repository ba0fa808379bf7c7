"""Fault campaigns: how often a loop fails its requirements under faults, how soon it notices, and where it breaks."""
