"""Parts of a step other than its method: guards, sensors, late samples, members of a bank, loops, its interpreters."""
