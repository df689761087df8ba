"""Derivatives of solutions: forward with them, or backward by the adjoint equation."""
