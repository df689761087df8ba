"""Runs of the compiled loop, from its record to what it reports."""
