"""Steering laws for a trailer's own axles."""
