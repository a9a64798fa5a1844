"""What a plant's equations tell: observability, the structure of forms and their hypotheses, their evidence."""
