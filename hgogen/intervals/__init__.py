"""Rigorous ranges on a box: interval arithmetic rounded outward, branch and bound, and what it proves."""
