"""A folder that a firmware project takes as it is: what each ecosystem asks for beside the emitted C, as data."""
