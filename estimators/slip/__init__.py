"""Slip angle estimators of rovers, and the odometry that uses them."""
