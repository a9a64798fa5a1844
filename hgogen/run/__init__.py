"""A step called from Python, and the evaluation of trials: metrics, figures, comparisons, Gramians, sensor noise."""
