"""The commands of the command line, and what they measure, compare, print and draw."""
