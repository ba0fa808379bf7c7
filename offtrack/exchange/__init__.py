"""Exchange with other programs: recordings, FMUs, a bench, exports and drawings."""
