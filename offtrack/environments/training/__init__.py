"""Training of a steering policy in the environments, and its comparison with steering laws."""
