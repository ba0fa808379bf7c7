"""A vehicle on one sheet: drawn to scale, with its loads, reach and handling."""
