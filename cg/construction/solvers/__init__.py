"""Solvers of nonlinear least-squares problems."""
