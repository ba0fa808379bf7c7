"""A field of sand that wheels leave their traces in, lit by one sun: what a rover's camera looks at."""
