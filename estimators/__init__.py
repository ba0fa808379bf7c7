"""Messages in, estimates out: pure init/step, usable on recordings without the simulator."""
