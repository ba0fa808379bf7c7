"""The rover: four or six wheels on loose soil or hard ground, skid-steered or with steered wheels."""
