"""Training of a steering policy in the environments, and its comparison with the laws that are there."""
