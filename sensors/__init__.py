"""Sensors: they turn ground truth into stamped messages, the only input of estimators and controllers."""
