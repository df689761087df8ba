"""Bring the flat methods of `flat_pairs.toml` to manifolds, as they are in the catalogue.

Those up to order seven are found from random starts by `cg.lift`. The split rows of order eight
took long to find; files beside this one have them in double precision, and they are refined from
there.

    python research/make_lifted_methods.py FOLDER [NAME ...]
"""

import re
import tomllib
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
from recipes import run

import cg
from cg.construction.layouts.layout import Layout
from cg.construction.lifting.exact import refined
from cg.construction.lifting.split_rows import FlatRows, SplitRows
from cg.construction.methods.flat import stage_orders
from cg.support.quads import DECIMAL_DIGITS, to_decimal

HERE = Path(__file__).parent
FLAT = HERE / "flat_pairs.toml"
STARTS = {
    "DOP853": HERE / "dop853_order8_start.toml",
    "CooperVerner8": HERE / "cooper_verner8_start.toml",
    "Verner8(7)": HERE / "verner8(7)_start.toml",
}

RECIPES: dict[str, dict[str, Any]] = {
    "DVERK6(5)": {"chains": [1, 2, 3, 3, 3, 3, 3, 5], "hits": 4, "improve": True},
    "Verner7(6)": {"chains": [1, 1, 2, 3, 3, 3, 3, 3, 3, 8]},
}
NOTE = "; lifted: the flat pair stays exact, its rows split into flows"
_IRRATIONAL = re.compile(r"(?P<p>\S+) (?P<sign>[+-]) (?P<q>\S+) r(?P<square>\d+)")


def make(name: str) -> cg.CommutatorFree:
    """Return a lifted method."""
    flat = tableaux()[name]
    if name in STARTS:
        method = from_start(flat)
    else:
        lifted = cg.lift(flat, **RECIPES[name])
        print(f"{name}: start {lifted.index} of {lifted.starts}, {lifted.hits} hits")
        method = lifted.method
    third = third_weights(name)
    return method if third is None else with_third(method, third)


def tableaux() -> dict[str, cg.Tableau]:
    """Return the flat methods by their names."""
    pairs = tomllib.loads(FLAT.read_text(encoding="utf-8"))
    return {
        name: cg.Tableau(
            [[number(text) for text in row] for row in pair["a"]],
            [number(text) for text in pair["b"]],
            b_embedded=pair.get("b_embedded"),
            name=name,
            source=pair["source"] + NOTE,
        )
        for name, pair in pairs.items()
    }


def third_weights(name: str) -> list[str] | None:
    """Return the third weights of a flat pair, if it has any."""
    weights: list[str] | None = tomllib.loads(FLAT.read_text(encoding="utf-8"))[name].get("b_third")
    return weights


def with_third(method: cg.CommutatorFree, third: list[str]) -> cg.CommutatorFree:
    """Return a method with third weights."""
    parents = [point.parent for point in method.points]
    return cg.CommutatorFree(
        zip(parents, method.point_coefficients, strict=True),
        method.stage_points,
        method.result,
        embedded_result=method.embedded_result,
        third=third,
        name=method.name,
        source=method.source,
    )


def number(text: str) -> str:
    """Return a rational number as it is, and ``p + q r6``, with the root of 6, with 36 digits."""
    parts = _IRRATIONAL.fullmatch(text)
    if parts is None:
        return text
    q = Fraction(parts["q"]) * (-1 if parts["sign"] == "-" else 1)
    root = Fraction(isqrt(int(parts["square"]) * 10**160), 10**80)
    return to_decimal(Fraction(parts["p"]) + q * root, DECIMAL_DIGITS)


def start_of(flat: cg.Tableau) -> tuple[SplitRows, np.ndarray]:
    """Return split rows that are stored in double precision."""
    stored = tomllib.loads(STARTS[flat.name].read_text(encoding="utf-8"))
    weights = [{int(k): w for k, w in point["weights"].items()} for point in stored["points"]]
    layout = Layout(
        tuple(point["parent"] for point in stored["points"]),
        tuple(tuple(sorted(row)) for row in weights),
        tuple(stored["stage_points"]),
        tuple(stored[key] for key in ("result", "embedded_result") if key in stored),
    )
    x = np.array([float.fromhex(row[k]) for row in weights for k in sorted(row)])
    rows = FlatRows(*flat.exact, flat.exact_embedded)
    orders = stored["order"], stored.get("embedded_order", 0)
    split = SplitRows(rows, layout, *orders, stage_orders(flat))
    return split, split.nearest(x)


def from_start(flat: cg.Tableau) -> cg.CommutatorFree:
    """Refine split rows stored in double precision."""
    split, x = start_of(flat)
    exact = refined(split, x)
    print(f"{flat.name}: rank {exact.rank}, residuals {exact.largest_residual:.0e}")
    return cg.CommutatorFree.from_layout(
        split.layout, exact.weights, name=flat.name, source=flat.source
    )


if __name__ == "__main__":
    run(make, tableaux(), __doc__)
