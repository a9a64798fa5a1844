"""Certificates verified again: code and arithmetic that share nothing with the rest of the package but its errors."""
