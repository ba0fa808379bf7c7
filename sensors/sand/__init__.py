"""A field of sand under one sun, in which wheels leave traces: the scene of a rover's camera."""
