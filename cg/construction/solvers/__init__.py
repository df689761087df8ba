"""Solvers of nonlinear least-squares problems."""

from __future__ import annotations

from cg.support.shared_numbers import Status

__all__ = ["Status"]
