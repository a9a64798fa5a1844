"""Learning from measured logs: parameters of the plant by multiple shooting, gains of the observer, whiteness."""
