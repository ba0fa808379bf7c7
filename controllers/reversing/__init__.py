"""Reversing along a path: model of the combination, reference and steering law."""
