"""What a plant's equations tell: Lie derivatives, determinants and their zeros, symmetries, what outputs observe."""
