"""What measured logs tell: parameters of the plant by multiple shooting, gains of the observer, whiteness."""
