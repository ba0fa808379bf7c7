"""The rover: four driven wheels on loose soil or hard ground, skid-steered or with every wheel steered."""
