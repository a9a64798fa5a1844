"""What a step is made of besides its method: guards, sensors, late samples, members of a bank, loops, its reading."""
