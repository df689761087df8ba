"""Compute the factors of proofs of impossibility with the computer algebra system Singular.

``python -m research.impossibility.find_proofs order4 FOLDER`` writes a file of proofs, which
``python -m research.impossibility`` checks without Singular.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cg.construction.conditions import condition_trees
from cg.construction.trees import forest
from research.impossibility.ring import singular
from research.impossibility.shapes import PathShape, Shape, TableauShape, point_shapes


def lift(
    shape: Shape | PathShape, given: Mapping[str, Any], target: str, seconds: float
) -> dict[str, str]:
    """Return factors that make `target` of the given polynomials; RuntimeError if none came."""
    names = list(given)
    program = [
        f"ring r = 0, ({','.join(shape.ring.names)}), dp;",
        "short = 0;",
        "ideal I = " + ",\n".join(str(given[name]) for name in names) + ";",
        f"matrix M = lift(I, ideal({target}));",
        "int k; for (k = 1; k <= ncols(I); k++) { print(string(M[k, 1])); }",
        "quit;",
    ]
    output = singular("\n".join(program), seconds)
    rows = output.split("\n")[: len(names)]
    if len(rows) < len(names):
        raise RuntimeError(f"Singular found no factors for {shape}: {output[:300]}")
    return {name: row for name, row in zip(names, rows, strict=True) if row.strip() != "0"}


def write(path: Path, order: int, stages: int, parts: Sequence[tuple[str, dict[str, Any]]]) -> None:
    """Write a proof as TOML."""
    lines = [f"order = {order}", *([f"stages = {stages}"] if stages else [])]
    for kind, part in parts:
        lines += ["", f"[[{kind}]]"]
        lines += [f'{key} = "{value}"' for key, value in part.items() if key != "factors"]
        lines += [f"[{kind}.factors]"]
        lines += [f'"{name}" = "{factor}"' for name, factor in part["factors"].items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def independent_conditions(shape: Shape | PathShape, order: int) -> dict[str, Any]:
    """Return the conditions from which all others follow, by the texts of their trees."""
    names = {str(forest(order + 1).tree(t)) for t in condition_trees(order, independent=True)}
    return {name: value for name, value in shape.conditions(order).items() if name in names}


class FlatLemmas:
    """Zeros of flat methods of order four with four stages: D(1), c_4 = 1 and more.

    Let d_j = Σ_i b_i a_ij - b_j (1 - c_j), the columns of N be c, c² and R = A c - c²/2 at stages
    2 to 4, and V the rows b, b c and (1, 0, 0) there. The conditions say d N = 0, and that V N has
    the rows (1/2, 1/3, 0), (1/3, 1/4, 0), (c_2, c_2², -c_2²/2), so that 144 det V det N = -c_2².
    So c_2² d = 0; and c_2 isn't zero, for 24 b_4 a_43 a_32 c_2 = 1.
    """

    def __init__(self) -> None:
        self.shape = TableauShape(4)
        self.flat = self.shape.flat_conditions(4)
        self.lemmas: list[dict[str, Any]] = []
        self._values: list[Any] = []
        self._derive()

    def _add(self, value: Any, factors: Mapping[str, Any]) -> str:
        texts = {name: str(factor) for name, factor in factors.items()}
        self.lemmas.append({"polynomial": str(value), "factors": texts})
        self._values.append(value)
        return f"lemma {len(self.lemmas)}"

    def given(self) -> dict[str, Any]:
        """Return the polynomials of the lemmas by their names."""
        return {f"lemma {k}": value for k, value in enumerate(self._values, 1)}

    def _derive(self) -> None:
        x, f = self.shape.ring, self.flat
        b = [x[f"b{i}"] for i in (2, 3, 4)]
        c = [x[f"c{i}"] for i in (2, 3, 4)]
        a32, a42, a43 = x["a3_2"], x["a4_2"], x["a4_3"]
        zero, one = x.number(0), x.number(1)
        d = [
            b[1] * a32 + b[2] * a42 - b[0] * (1 - c[0]),
            b[2] * a43 - b[1] * (1 - c[1]),
            -b[2] * (1 - c[2]),
        ]
        inner = [zero, a32 * c[0], a42 * c[0] + a43 * c[1]]
        n = [c, [k**2 for k in c], [ac - k**2 / 2 for ac, k in zip(inner, c, strict=True)]]
        v = [b, [w * k for w, k in zip(b, c, strict=True)], [one, zero, zero]]
        steep = {"[[[[]]]]": one, "[[[]]]": -one, "[[[]][]]": one}
        bushy = {"[[[][]]]": one, "[[][]]": -one, "[[][][]]": one}
        products = [{"[[[]]]": one, "[[]]": -one, "[[][]]": one}, bushy]
        products.append(steep | {name: -factor / 2 for name, factor in bushy.items()})
        zeros = [self._add(_dot(row, d), factors) for row, factors in zip(n, products, strict=True)]
        e0 = self._add(_dot(v[0], n[2]), {"[[[]]]": one, "[[][]]": -one / 2})
        e1 = self._add(_dot(v[1], n[2]), {"[[[]][]]": one, "[[][][]]": -one / 2})
        f1, f2, f3 = f["[[]]"], f["[[][]]"], f["[[][][]]"]
        q, s = c[0], c[0] ** 2
        determinant = self._add(
            144 * _determinant(v) * _determinant(n) + s,
            {
                "[[]]": -72 * s * (f3 + one / 4),
                "[[][]]": 72 * s * (f2 + one * 2 / 3),
                "[[][][]]": -36 * s,
                e0: 144 * ((f2 + one / 3) * s - (f3 + one / 4) * q),
                e1: 144 * ((f2 + one / 3) * q - (f1 + one / 2) * s),
            },
        )
        last, tall = f["[[[[]]]]"], "[[[[]]]]"
        u = 24 * b[2] * a43 * a32
        columns = []
        for j in range(3):
            times = {
                name: -144 * _determinant(v) * _cofactor(n, k, j) for k, name in enumerate(zeros)
            }
            raised = self._add(s * d[j], {**times, determinant: d[j]})
            factors = {raised: u**2, tall: -24 * (u * q + 1) * d[j]}
            columns.append(self._add(d[j], factors))
        end = c[2] - 1
        at_one = self._add(end, {columns[2]: 24 * a43 * a32 * q, tall: -24 * end})
        link = self._add(last - a32 * q * d[1], {tall: one, columns[1]: -a32 * q})
        bend, scale = c[1] * (c[1] - q), 24 * a32 * q
        self._add(
            bend - scale * (1 - 2 * q) / 12,
            {
                "[[]]": -scale * q,
                "[[][]]": scale * (1 + q),
                "[[][][]]": -scale,
                at_one: scale * b[2] * c[2] * (c[2] - q),
                link: -24 * bend,
            },
        )


def _dot(row: Sequence[Any], column: Sequence[Any]) -> Any:
    first, *others = (x * y for x, y in zip(row, column, strict=True))
    return sum(others, first)


def _cofactor(matrix: Sequence[Sequence[Any]], row: int, column: int) -> Any:
    (p, q), (r, s) = (
        [entry for k, entry in enumerate(entries) if k != column]
        for m, entries in enumerate(matrix)
        if m != row
    )
    return (p * s - q * r) * (-1) ** (row + column)


def _determinant(matrix: Sequence[Sequence[Any]]) -> Any:
    return _dot(matrix[0], [_cofactor(matrix, 0, k) for k in range(3)])


def prove_order_four(path: Path) -> None:
    """Four stages, and trees of four points, at order four."""
    flat = FlatLemmas()
    parts: list[tuple[str, dict[str, Any]]] = [("lemma", lemma) for lemma in flat.lemmas]
    useful = dict(list(flat.given().items())[-6:])
    for shape in [flat.shape, *point_shapes(4)]:
        given = useful | independent_conditions(shape, 4)
        parts.append(("claim", {"shape": str(shape), "factors": lift(shape, given, "1", 60)}))
        print(shape, sum(map(len, parts[-1][1]["factors"].values())))
        write(path, 4, 4, parts)


PATHS = {3: 1, 5: 2, 6: 3, 7: 4}  # by the order, flows to the result that aren't enough


def prove_path(path: Path, order: int) -> None:
    """Few flows to the result."""
    shape = PathShape(PATHS[order])
    given = independent_conditions(shape, order)
    if shape.ring.names:
        factors = lift(shape, given, "1", 60)
    else:  # the conditions are numbers
        name, number = next((name, value) for name, value in given.items() if value != 0)
        factors = {name: str(1 / number.leading_coefficient())}
    write(path, order, 0, [("claim", {"shape": str(shape), "factors": factors})])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=[f"order{q}" for q in sorted({4, *PATHS})])
    parser.add_argument("folder", type=Path)
    chosen = parser.parse_args(arguments)
    path = chosen.folder / f"{chosen.name}.toml"
    order = int(chosen.name.removeprefix("order"))
    if order == 4:
        prove_order_four(path)
    else:
        prove_path(path, order)
    return 0


if __name__ == "__main__":
    sys.exit(main())
