"""Tractors with the units that they tow: data, equations of motion, and the plant that steps them."""
