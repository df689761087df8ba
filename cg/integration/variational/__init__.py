"""Derivatives of solutions with respect to initial points and parameters."""
