"""Runs of compiled code over steps, and what they leave."""
