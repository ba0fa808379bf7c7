"""FMUs of other tools as parts of a run: steering laws, drivers, plants."""
