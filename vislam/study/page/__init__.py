"""The page of a study: tables, figures, verdict."""
