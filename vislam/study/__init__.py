"""Studies: many trials of one comparison, and what they say together."""
