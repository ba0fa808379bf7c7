"""Signals of finished runs as files for other tools."""
