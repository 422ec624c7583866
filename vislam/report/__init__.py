"""What a person reads: figures, the table and one self-contained page."""
