"""Many runs: grids of scenarios in parallel processes, resumed where they were left, and what they show together."""
