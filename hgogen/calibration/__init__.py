"""Gains of observers from measured records: noise by likelihood, the rest by predictions, judged by segments."""
