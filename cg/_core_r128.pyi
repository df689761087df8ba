# The compiled core in real(16), whose numbers are rows of 16 bytes.
from cg._core_r64 import fit_lmdif, from_double, highest_order, jacobian, residuals, to_double

__all__ = ["fit_lmdif", "from_double", "highest_order", "jacobian", "residuals", "to_double"]
