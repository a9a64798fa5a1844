"""A step as text: the printers, what a language is to them, heads, structs, self-checks, and what a call costs."""
