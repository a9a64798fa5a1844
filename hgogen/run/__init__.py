"""A step called from Python, and what a trial shows: metrics, figures, comparisons, Gramians, the response to noise."""
