"""Words that everything is written in: quantities with units and limits, and readers of files."""
