"""The estimators, the loop that feeds them, and the contract that they keep."""
