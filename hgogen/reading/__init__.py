"""User input: text, expressions, tables, names, numbers, plain-text models and CasADi graphs."""
