"""What observers with a covariance share: the Riccati part, its forms, what is known of them, persistence."""
