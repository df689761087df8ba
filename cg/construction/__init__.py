"""Construction of methods: trees, order conditions, methods, search, lifting, proofs, catalogue.

What integrates with methods imports nothing of this; it reads their tables (`cg.tables`).
"""
