"""The evidence of claims in a certificate: what `hgogen recheck` needs to verify each of them again."""
