"""The residuals of the core in real(16), exactly as it computes them."""

import numpy as np

from cg import _core_r128
from cg.construction.conditions import condition_trees
from cg.support.quads import decode, encode


def residuals_quad(layout, x, order, independent=False):
    """Return the residuals at packed weights, which are rounded to binary128 first."""
    trees = np.array(condition_trees(order, independent), dtype=np.intc)
    bits = _core_r128.residuals(order, layout.code, encode(x).T, trees)
    return decode(np.ascontiguousarray(bits.T))
