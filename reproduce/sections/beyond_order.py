"""Orders in quadruple precision of methods of order six and more, beside the paper's CG6a."""

from collections.abc import Sequence

from cg.construction.catalogue import methods
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.tableau import Tableau

from ..blocks import Block, Data, Table, Text, number, places
from ..context import Context, Item
from ..quad_orders import FIT, convergence

_LOWEST_ORDER = 6
_POWERS = range(2, 12)
_FLOWS = 2**20
"""Largest number of flows of an integration, about ten seconds of one core."""


def select() -> list[str]:
    """Return the explicit methods of order six and more, by order."""
    explicit = [
        m for m in methods.values() if m.explicit and isinstance(m, Tableau | CommutatorFree)
    ]
    chosen = [method for method in explicit if method.order >= _LOWEST_ORDER]
    return [method.name for method in sorted(chosen, key=lambda m: (m.order, m.name))]


def compute(context: Context) -> Data:
    """Return ``readings``, the `quad_orders.convergence` with stepsizes from 1/4 to 1/2048."""
    steps = {
        name: [2**power for power in _POWERS if 2**power * methods[name].exponentials <= _FLOWS]
        for name in select()
    }
    return {"readings": convergence(context, steps)}


def present(data: Data) -> Sequence[Block]:
    """Tabulate slopes."""
    header = ("method", "order", "stages", "smallest h", "error there",
              f"slope over the last {FIT} points", "last slope")  # fmt: skip
    tables = [
        Table(
            f"Slopes in quadruple precision, {reading}",
            header,
            [_row(name, run) for name, run in part["methods"].items()],
        )
        for reading, part in data["readings"].items()
    ]
    return (
        Text(
            "The spinning top again, in quadruple precision, with every explicit method of the "
            "catalogue whose order is six or more. CG6a is the paper's, as printed: its "
            "coefficients satisfy the conditions through order six approximately, and its error "
            "stops falling once that shows. The others satisfy them to all their digits."
        ),
        *tables,
    )


def _row(name: str, run: Data) -> list[str]:
    method = methods[name]
    return [
        name,
        f"{method.order}{', nominal' * method.approximate}",
        number(method.stages),
        number(run["h"][-1]),
        number(run["error"][-1]),
        places(run["slope"]),
        places(run["local"][-1]),
    ]


_TITLE = "Beyond the paper: exact methods of order six and more"
ITEMS = (Item("beyond.order", _TITLE, 100, 100, compute, present),)
