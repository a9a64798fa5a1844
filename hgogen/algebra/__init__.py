"""Exact algebra on expressions: tapes, quotients of polynomials, zero tests, generic ranks, signs of eigenvalues."""
