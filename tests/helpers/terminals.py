"""Streams that count as terminals."""
