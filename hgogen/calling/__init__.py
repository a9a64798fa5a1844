"""A step called from Python: compiled, or as Python text with the same bits; what goes in and what comes out."""
