"""Constant and moving high gains, and the bounds above which their convergence is proved."""
