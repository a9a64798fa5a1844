"""What a step costs on a Cortex-M4F, counted in QEMU: the board's own C, the program around the step, its run."""
