"""Exact algebra on expressions, and ranges on a box by interval arithmetic rounded outward."""
