"""Analysis of a plant's equations: observability, the structure of forms and their hypotheses, their evidence."""
