"""Shared parts of observers: Riccati parts and theta, chains of integrators, linear cores, saturations, persistence."""
