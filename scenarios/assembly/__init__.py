"""Assembly: build the parts of a run from the options of its scenario."""
