"""The catalogue as a table, computed from coefficients except for the column of certificates."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from cg.construction.catalogue import methods
from cg.construction.conditions import count
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.proofs import certificate_of
from cg.construction.proofs.files import certificate_names

from ..blocks import Block, Data, Table, Text, number, places
from ..coefficients import RANK_THRESHOLD, singular_values
from ..context import Context, Item
from ..markdown import table as markdown_table

_EXPLANATION = (
    "Order: p(q) for a pair whose second weights have order q; ≈ if the conditions hold "
    "approximately. Exponentials: flows per step, where flows that several rows share count once; "
    "an implicit method repeats those of its stages. Principal error: 2-norm of the residuals of "
    "order q + 1. Effort: exponentials times the q-th root of the principal error, which compares "
    "methods of the same order at equal accuracy. Residual: the largest through the order, in "
    "rational arithmetic. Rank: that of the Jacobian of the independent conditions, and their "
    "number. These columns were computed in this run. The last column is read from the "
    "certificates' files: the radius around the stored coefficients within which an exact method "
    "was proved to exist, 0 if the coefficients are exact, and in part if this was proved for "
    "independent conditions and the others were proved to be tiny. crouch-grossman certify --check "
    "repeats the proofs."
)


def compute(context: Context) -> Data:
    """Return ``methods``, what `describe` returns of all, the explicit ones first, by order."""
    entries = []
    described = [m for m in methods.values() if isinstance(m, Tableau | CommutatorFree)]
    for done, method in enumerate(described):
        context.progress(done, len(described))
        entries.append(describe(method))
    return {"methods": sorted(entries, key=_place)}


def _place(entry: Data) -> tuple[Any, ...]:
    return (
        not entry["explicit"],
        entry["order"],
        entry["embedded_order"] is not None,
        entry["name"],
    )


def describe(method: Method) -> dict[str, Any]:
    """Return the properties of a method of the catalogue.

    The keys are ``name``, ``source``, ``explicit``, ``order``, ``approximate`` (the order is
    nominal), ``embedded_order`` (null without a second result), ``stages``, ``exponentials``,
    ``largest_coefficient`` on the way to stages and result, ``abscissae`` (smallest and largest),
    ``principal_error`` and ``effort`` (see the report), ``largest_residual`` through the order in
    rational arithmetic, ``rank`` of the Jacobian of the independent ``conditions``,
    ``certificate``: null or, from its file, ``radius`` (decimal text), ``complete``, and the number
    of conditions ``left_out``.
    """
    abscissae = [sum(row, Fraction(0)) for row in method.exact[0]]
    tree = method.tree
    used = {m for end in (*tree.stage_points, tree.result) for m in tree.path(end)}
    error, singular = method.principal_error, singular_values(method, method.order)
    return {
        "name": method.name,
        "source": method.source,
        "explicit": method.explicit,
        "order": method.order,
        "approximate": method.approximate,
        "embedded_order": method.embedded_order,
        "stages": method.stages,
        "exponentials": method.exponentials,
        "largest_coefficient": float(
            max(abs(weight) for m in used for weight in tree.points[m].weights.values())
        ),
        "abscissae": [float(min(abscissae)), float(max(abscissae))],
        "principal_error": error,
        "effort": method.exponentials * error ** (1 / method.order),
        "largest_residual": method.largest_residual(),
        "rank": int((singular > RANK_THRESHOLD * singular[0]).sum()),
        "conditions": count(method.order, independent=True),
        "certificate": _certificate(method),
    }


def _certificate(method: Method) -> Data | None:
    if method.name not in certificate_names():
        return None
    certificate = certificate_of(method)
    return {
        "radius": str(certificate.radius).lower(),
        "left_out": len(certificate.left_out),
        "complete": certificate.complete,
    }


def present(data: Data) -> Sequence[Block]:
    """Explain and show the table."""
    return Text(_EXPLANATION), table(data)


def table(data: Data) -> Table:
    """Make the table of what `compute` returns."""
    return Table(
        "The catalogue",
        ("method", "order", "stages", "exponentials", "largest coefficient", "abscissae",
         "principal error", "effort", "residual", "rank", "certificate (from its file)"),
        [_row(entry) for entry in data["methods"]],
    )  # fmt: skip


def _row(entry: Data) -> list[str]:
    order = number(entry["order"])
    if entry["embedded_order"] is not None:
        order += f"({entry['embedded_order']})"
    if entry["approximate"]:
        order = f"≈ {order}"
    certificate = entry["certificate"]
    low, high = (places(value, 2) for value in entry["abscissae"])
    return [
        entry["name"],
        order,
        number(entry["stages"]),
        number(entry["exponentials"]),
        number(entry["largest_coefficient"]),
        f"{low} … {high}",
        number(entry["principal_error"]),
        number(entry["effort"]),
        number(entry["largest_residual"], 1),
        f"{entry['rank']} of {entry['conditions']}",
        _proved(certificate),
    ]


def _proved(certificate: Data | None) -> str:
    if certificate is None:
        return number(None)
    radius = number(float(certificate["radius"]), 2)
    return radius if certificate["complete"] else f"in part {radius}"


def markdown(shown: Table) -> str:
    """Write a table in Markdown, its first column as code."""
    rows = [[f"`{first}`", *rest] for first, *rest in shown.rows]
    return markdown_table(shown.header, rows) + "\n"


ITEMS = (Item("beyond.catalogue", "Beyond the paper: the catalogue", 110, 110, compute, present),)
