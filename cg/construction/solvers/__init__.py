"""Solvers of nonlinear least-squares problems."""

from cg.support.shared_numbers import Status

__all__ = ["Status"]
