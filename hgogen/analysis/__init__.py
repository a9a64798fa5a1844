"""What a plant's equations tell: Lie derivatives, observability determinants and their zeros, symmetries."""
