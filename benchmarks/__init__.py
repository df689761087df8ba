"""Benchmarks: each a ratio between two ways to compute the same, measured in one run.

``python -m benchmarks`` runs them all, writes the table in ``docs/benchmarks.md`` and the
numbers to ``benchmarks/results.json``.
"""
