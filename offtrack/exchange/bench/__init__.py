"""Hardware in the loop: signals of a run out and demands of a controller on a bench in, by UDP or CAN."""
