"""Observed orders of convergence, and diagnosis of coefficients."""
