"""Off-tracking estimators, and the buffer that keeps the path of the hitch.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018.
"""
