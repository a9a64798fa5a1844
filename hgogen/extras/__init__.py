"""Extras for firmware projects: folders for their ecosystems, and the cost of a step on a Cortex-M4F in QEMU."""
