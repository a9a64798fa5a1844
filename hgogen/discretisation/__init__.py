"""Explicit Runge-Kutta methods as data, the step lengths that they admit, and the transient growth of errors."""
