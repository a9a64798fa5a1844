"""What observers share: Riccati parts and theta, chains of integrators, linear cores, saturations, persistence."""
