"""The contents and places of model files: observers and their gains, trials, requested error bounds."""
