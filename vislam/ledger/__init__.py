"""The ledger of results: comparisons, studies and inspections below a folder, from their saved files."""
