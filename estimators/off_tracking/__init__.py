"""Off-tracking estimators, and the buffer that keeps the path of the hitch."""
