"""What a proof says of itself in a certificate: exact numbers, expressions in its grammar, bisections as text."""
