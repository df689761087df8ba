"""Construction of methods: trees, order conditions, methods, search, lifting, proofs, catalogue.

Integrators import nothing of this; they read the tables of methods (`cg.tables`).
"""
