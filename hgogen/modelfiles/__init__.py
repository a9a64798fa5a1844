"""The tables of a model file: observers and their gains by name, the trial, what is asked of the errors."""
