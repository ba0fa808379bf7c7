"""Stereo and rover recordings: writers, readers, estimation, summary and report."""
