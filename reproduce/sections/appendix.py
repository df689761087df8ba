"""Appendix A, coefficient by coefficient."""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Any

from cg import conditions
from cg.construction.catalogue import methods
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.support.quads import to_decimal

from ..blocks import Block, Context, Data, Item, Table, Text, number
from ..coefficients import compare, labels, nearest_exact, printed


def compute(context: Context) -> Data:
    """Compare every printed coefficient with the catalogue's, by method.

    ``coefficients`` have ``label``, ``paper``, ``ours`` (36 digits) and ``difference``. There are
    the largest difference, of c against row sums of printed a too; how far exact methods are off
    ``if_truncated`` and ``if_rounded`` (`coefficients.nearest_exact`; null where there are none);
    and of the ``paper``'s and ``our`` coefficients, exactly evaluated, the norm of all residuals, f
    over the independent ones, and the largest residual.
    """
    by_method = {}
    for done, (name, paper) in enumerate(printed().items()):
        context.progress(done, len(printed()))
        ours, rows = methods[name], compare(name)
        differences = [float(value - Fraction(digits)) for _, digits, value in rows]
        places = len(paper.b[0].partition(".")[2])
        nearest = None if ours.approximate else partial(nearest_exact, name)
        by_method[name] = {
            "order": ours.order,
            "stages": ours.stages,
            "decimals": places,
            "coefficients": [
                {"label": label, "paper": digits, "ours": to_decimal(value), "difference": off}
                for label, (_, digits, value), off in zip(
                    labels(ours.stages), rows, differences, strict=True
                )
            ],
            "count": len(rows),
            "largest_difference": max(map(abs, differences)),
            "if_truncated": nearest and nearest(truncated=True),
            "if_rounded": nearest and nearest(truncated=False),
            "zeros_kept": not any(value and not Fraction(digits) for _, digits, value in rows),
            "residuals": {
                "paper": _residuals(Tableau(paper.a, paper.b), ours.order),
                "ours": _residuals(ours, ours.order),
            },
        }
    return {"methods": by_method}


def _residuals(method: Method, order: int) -> dict[str, float]:
    every = conditions.residuals(method, order, arithmetic="exact")
    independent = conditions.residuals(method, order, independent=True, arithmetic="exact")
    total = sum((r * r for r in every), Fraction(0))
    return {
        "norm": float(total) ** 0.5,
        "f": float(sum((r * r for r in independent), Fraction(0))),
        "largest": float(max(map(abs, every))),
    }


def present(data: Data) -> Sequence[Block]:
    """Tabulate residuals, then all coefficients."""
    rows = [
        [
            name,
            number(part["order"]),
            number(part["decimals"]),
            number(part["largest_difference"], 2),
            number(part["if_truncated"], 2),
            number(part["if_rounded"], 2),
            *(number(part["residuals"][whose][what], 2)
              for what in ("norm", "largest", "f") for whose in ("paper", "ours")),
        ]
        for name, part in data["methods"].items()
    ]  # fmt: skip
    blocks: list[Block] = [
        Text(
            "CG4a and CG5a were refined in real(16) from the printed digits and carry 36 digits; "
            "CG6a is no exact zero near its printed digits and stands as the paper has it. "
            "Residuals are evaluated in exact rational arithmetic. Our c are exact row sums. "
            "Units off: of the last printed place, at least, by which an exact method differs from "
            "the middle of what is truncated, or rounded, to these digits; at most 0.5 where it is."
        ),
        Table(
            "Printed coefficients beside ours",
            ("method", "order", "decimals", "largest difference",
             "units off if truncated", "if rounded",
             "residual norm, paper", "ours", "largest residual, paper", "ours", "f, paper", "ours"),
            rows,
        ),
    ]  # fmt: skip
    blocks += [_coefficients(name, part) for name, part in data["methods"].items()]
    return blocks


def _coefficients(name: str, part: dict[str, Any]) -> Table:
    rows = [
        [row["label"], *(row[key].replace("-", "−") for key in ("paper", "ours")),
         number(row["difference"], 2)]
        for row in part["coefficients"]
    ]  # fmt: skip
    header = ("coefficient", "paper", "ours", "ours − paper")
    return Table(f"{name}: {part['count']} coefficients", header, rows, folded=True)


ITEMS = (Item("appendix", "Appendix A", 20, 60, compute, present),)
