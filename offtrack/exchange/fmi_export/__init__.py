"""FMUs out: offtrack's plants as C that other tools simulate, FMI 2 and 3."""
