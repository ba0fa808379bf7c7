"""Standard manoeuvres: what a combination does in them, measured from a log, against the levels of the standards."""
