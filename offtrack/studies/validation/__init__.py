"""Validation of the vehicle model against theory, published tables and independent models."""
