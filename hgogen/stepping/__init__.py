"""What a step is made of besides its method: guards, sensors, members of a bank, matrix loops, and its reading."""
