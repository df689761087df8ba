"""The table of docs/catalogue.md, computed from coefficients except for the certificates."""

from collections.abc import Iterable
from typing import Any

from cg.construction.catalogue import methods
from cg.construction.conditions import count
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.construction.methods.tableau import Tableau
from cg.construction.proofs import certificate_of
from cg.construction.proofs.packed import certificate_names

from .blocks import Data, Table, number
from .coefficients import RANK_THRESHOLD, singular_values
from .markdown import table as markdown_table


def entries() -> list[dict[str, Any]]:
    """Return what `describe` returns of all tableaux and commutator-free methods, by order."""
    shown = (m for m in methods.values() if isinstance(m, Tableau | CommutatorFree))
    return sorted(
        map(describe, shown),
        key=lambda e: (not e["explicit"], e["order"], e["embedded_order"] is not None, e["name"]),
    )


def describe(method: Method) -> dict[str, Any]:
    """Return the properties of a method of the catalogue, those of `docs/catalogue.md`."""
    tree = method.tree
    used = {m for end in (*tree.stage_points, tree.result) for m in tree.path(end)}
    error, singular = method.principal_error, singular_values(method, method.order)
    proof = certificate_of(method) if method.name in certificate_names() else None
    return {
        "name": method.name,
        "explicit": method.explicit,
        "order": method.order,
        "approximate": method.approximate,
        "embedded_order": method.embedded_order,
        "stages": method.stages,
        "exponentials": method.exponentials,
        "largest_coefficient": float(
            max(abs(weight) for m in used for weight in tree.points[m].weights.values())
        ),
        "principal_error": error,
        "effort": method.exponentials * error ** (1 / method.order),
        "max_residual": method.max_residual(),
        "rank": int((singular > RANK_THRESHOLD * singular[0]).sum()),
        "conditions": count(method.order, independent=True),
        "certificate": proof and {"radius": str(proof.radius).lower(), "complete": proof.complete},
    }


def table(entries: Iterable[Data]) -> Table:
    """Make the table of what `entries` returns."""
    return Table(
        "The catalogue",
        ("method", "order", "stages", "flows", "largest coefficient", "principal error", "effort",
         "rank", "certificate"),
        list(map(_row, entries)),
    )  # fmt: skip


def _row(entry: Data) -> list[str]:
    pair = "" if entry["embedded_order"] is None else f"({entry['embedded_order']})"
    certificate, proved = entry["certificate"], number(None)
    if certificate is not None:
        radius = number(float(certificate["radius"]), 2)
        proved = radius if certificate["complete"] else f"in part {radius}"
    return [
        entry["name"],
        f"{'≈ ' * entry['approximate']}{entry['order']}{pair}",
        number(entry["stages"]),
        number(entry["exponentials"]),
        number(entry["largest_coefficient"]),
        number(entry["principal_error"]),
        number(entry["effort"]),
        f"{entry['rank']} of {entry['conditions']}",
        proved,
    ]


def markdown(shown: Table) -> str:
    """Write a table in Markdown, its first column as code."""
    rows = [[f"`{first}`", *rest] for first, *rest in shown.rows]
    return markdown_table(shown.header, rows) + "\n"
