"""Finished runs, from their files: laid over each other in one page, or played alone."""
