"""Data sheets of vehicles and rovers: numbers, tables, and drawings to scale."""
