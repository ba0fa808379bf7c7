"""Roads of OpenDRIVE files (ASAM OpenDRIVE 1.4 to 1.8): reference lines, lanes, links, and routes along lanes."""
