"""FTrace, the wheel trace detector of Reina 2008: edges, lines, fuzzy choice, slip angle."""
