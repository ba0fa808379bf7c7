"""Engines that run CasADi functions: interpreted or compiled to C, for one vehicle or for many at once."""
