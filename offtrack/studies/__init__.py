"""Studies: grids of runs in parallel processes, resumable, with tables and reports."""
