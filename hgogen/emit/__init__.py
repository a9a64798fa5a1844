"""A step as C text: the printer, structs, functions, header and self-check, and what a call costs."""
