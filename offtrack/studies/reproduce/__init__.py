"""Reproductions of tables and figures of the papers behind this project."""
