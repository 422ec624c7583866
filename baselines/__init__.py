"""What the estimators are to be compared with; found by name through the entry points."""
