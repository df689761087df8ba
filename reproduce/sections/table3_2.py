"""The table of Section 3.2: parameters and order conditions of the methods searched for."""

from collections.abc import Sequence

from cg.construction.conditions import count, table_rows, unknowns
from cg.construction.trees import rooted_trees_through

from ..blocks import Block, Context, Data, Item, Table, Text, number

PAPER = (
    {"q": 4, "s": 5, "n": 15, "N_CG": 13, "N_RK": 8},
    {"q": 5, "s": 9, "n": 45, "N_CG": 38, "N_RK": 17},
    {"q": 6, "s": 16, "n": 136, "N_CG": 113, "N_RK": 37},
)
"""The table as printed."""


def compute(context: Context) -> Data:
    """Count unknowns and conditions anew.

    Each of ``rows`` has the ``paper`` and ``computed`` numbers, whether they ``agree``, and the
    rows of the integer table of Section 3.1: ``trees`` in all, ``discarded`` among them.
    """
    rows = []
    for paper in PAPER:
        q, s = paper["q"], paper["s"]
        computed = {
            "q": q,
            "s": s,
            "n": unknowns(s),
            "N_CG": count(q, independent=True),
            "N_RK": len(rooted_trees_through(q)),
        }
        table = table_rows(q)
        rows.append(
            {
                "paper": paper,
                "computed": computed,
                "agree": computed == paper,
                "trees": len(table),
                "discarded": table.count(0),
            }
        )
    return {"rows": rows}


def present(data: Data) -> Sequence[Block]:
    """Set the paper's numbers beside ours."""
    rows = []
    for row in data["rows"]:
        paper, ours = row["paper"], row["computed"]
        cells = [number(ours["q"]), number(ours["s"])]
        for key in ("n", "N_CG", "N_RK"):
            cells += [number(paper[key]), number(ours[key])]
        cells += [number(row["trees"]), number(row["discarded"])]
        rows.append([*cells, "pass" if row["agree"] else "fail"])
    return (
        Text(
            "n = s(s + 1)/2 free parameters of an explicit method; N_CG conditions that don't "
            "follow from lower ones, counted as Lyndon words of ordered trees; N_RK rooted "
            "trees whose children have no order, with 1 to q nodes. The last two counts are the "
            "rows of the integer table of Section 3.1, one a tree, and the zeros among them."
        ),
        Table(
            "Free parameters and order conditions",
            ("q", "s", "n, paper", "n, ours", "N_CG, paper", "N_CG, ours", "N_RK, paper",
             "N_RK, ours", "trees", "discarded", "agreement"),
            rows,
        ),
    )  # fmt: skip


ITEMS = (Item("table3.2", "Table of Section 3.2", 10, 20, compute, present),)
