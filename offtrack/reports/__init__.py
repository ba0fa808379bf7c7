"""Pages, figures and videos of runs."""
