"""What observers on chains of integrators share: their core, how the output error is injected, saturations."""
