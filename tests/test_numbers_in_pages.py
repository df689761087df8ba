"""Numbers in prose are those of stored data: a stale one fails here."""

from collections import Counter
from pathlib import Path

import pytest

import cg
from cg import conditions
from cg.certification import certificate_of, proved

ROOT = Path(__file__).parents[1]


def proofs():
    counts = Counter(map(proved, cg.methods.values()))
    yield (
        "certificates",
        f"Of the {len(cg.methods)} methods of the catalogue the orders of {counts['whole']} are "
        f"proved; of {counts['partly']} it is",
    )
    for name, method in cg.methods.items():
        if proved(method) == "partly":
            (small,) = certificate_of(method).identities
            heading, _, trees = small.partition(": ")
            orders = (method.order, *filter(None, (method.embedded_order,)))
            parts = [conditions.count(order, independent=True) for order in orders]
            left = len(trees.split())
            yield (
                "certificates",
                f"| {name} | {' + '.join(map(str, parts))} | {sum(parts) - left} | {left} | "
                f"{heading.rpartition(' ')[2]} |",
            )


SENTENCES = [*proofs()]


@pytest.mark.parametrize(("page", "sentence"), SENTENCES)
def test_a_page_says_what_is_stored(page, sentence):
    text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
    assert sentence in " ".join(text.split())


def test_the_table_of_partial_proofs_has_no_others():
    text = (ROOT / "docs" / "certificates.md").read_text("utf-8")
    rows = text.partition("| only small |")[2].partition("\n\n")[0].splitlines()[2:]
    assert len(rows) == sum(proved(method) == "partly" for method in cg.methods.values())
