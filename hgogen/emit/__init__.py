"""A step as C text: the printer, structs, functions, header and self-check; compiled and called on this machine."""
