"""Certificates: the proved claims about a model, with the evidence that `hgogen recheck` verifies again."""
