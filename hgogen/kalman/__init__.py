"""What observers with a covariance share: the Riccati part and its forms, theta and what moves it, persistence."""
