"""Measurements of this checkout that no user needs: time, growth, and what documents refer to."""
