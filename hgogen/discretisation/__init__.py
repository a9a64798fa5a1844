"""Explicit Runge-Kutta methods as data, the step lengths that they admit, and how far an error grows on its way."""
