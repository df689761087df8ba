"""Order conditions of Runge–Kutta methods on manifolds, see `cg.construction.conditions`."""

from cg.construction.conditions import (
    MAX_ORDER,
    Rows,
    check_rows,
    condition_trees,
    count,
    equations,
    jacobian,
    pack,
    residuals,
    right_sides,
    table_rows,
    unknowns,
    unpack,
    weights,
)

__all__ = [
    "MAX_ORDER",
    "Rows",
    "check_rows",
    "condition_trees",
    "count",
    "equations",
    "jacobian",
    "pack",
    "residuals",
    "right_sides",
    "table_rows",
    "unknowns",
    "unpack",
    "weights",
]
