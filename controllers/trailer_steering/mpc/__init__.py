"""Model predictive trailer steering: a trailer model with tyre slip, on the measured path of the hitch."""
