"""Parameters of a plant from measured records: multiple shooting, and what the records tell of them."""
