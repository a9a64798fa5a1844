"""Proofs about an observer's error: gains, the bounds above which they converge, dissipation, inequalities."""
