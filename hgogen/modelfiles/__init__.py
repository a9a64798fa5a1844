"""What model files hold, and where they lie: observers and their gains, the trial, what is asked of the errors."""
