"""What comes in at the door: text, expressions, tables, names, numbers, plain-text models and CasADi graphs."""
