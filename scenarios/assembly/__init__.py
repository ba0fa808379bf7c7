"""From the options of a scenario to the parts of its run."""
