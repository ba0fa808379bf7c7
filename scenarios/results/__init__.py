"""Results of runs: signals, metrics, summaries, and run directories."""
