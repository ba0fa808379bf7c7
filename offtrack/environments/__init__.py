"""Environments to train steering policies in, for one vehicle and for many at once."""
