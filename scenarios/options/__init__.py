"""The tables of a scenario file as frozen, validated options, a module for each part of the house."""
