"""Runs as data for a page that plays them: what moves, what is drawn, charts and pictures."""
