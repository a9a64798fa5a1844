"""What forms are made of: orders of states, coordinates and their changes, the hypotheses on a_i, b and the output."""
