"""What a firmware project takes: the folders of its ecosystem, and what a step costs on a Cortex-M4F in QEMU."""
