"""What observers on chains of integrators share: gains, the linear core, injection of the output error, saturations."""
