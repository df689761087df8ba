"""Solvers of nonlinear least-squares problems."""

from __future__ import annotations

from cg.solve.status import Status

__all__ = ["Status"]
