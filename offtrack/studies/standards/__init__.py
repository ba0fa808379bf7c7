"""Standard manoeuvres: drives, measured quantities, and comparison with the limits of the standards."""
