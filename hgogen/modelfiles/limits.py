"""How much a trial may ask for."""

SEEDS = 1000  # of the noise of a trial, at most
