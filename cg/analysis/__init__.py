"""Observed orders of convergence, and diagnosis of given coefficients."""
