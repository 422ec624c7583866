"""vislam."""
