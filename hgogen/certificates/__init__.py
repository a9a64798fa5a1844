"""Certificates: what was proved of a model, and the evidence with which `hgogen recheck` verifies it again."""
