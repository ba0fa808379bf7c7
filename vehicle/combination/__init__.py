"""Tractors and the units they tow: data, equations of motion, and the plants that step them."""
