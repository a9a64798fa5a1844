"""Parameters of a plant from measured records: multiple shooting, prediction error, and what the records tell."""
