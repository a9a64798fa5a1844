"""Certificates verified again, by code and arithmetic of its own; the folder runs alone where mpmath is installed."""
