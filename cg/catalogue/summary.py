"""What there is to say of each method in a line: computed once, and kept for the catalogue."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from ..conditions import MAX_ORDER
from ..method.commutator_free import CommutatorFree
from ..method.method import Method
from ..method.munthe_kaas import MuntheKaas
from ..method.stability import stability_limits, too_large
from ..support.parsing import write_file
from . import methods, munthe_kaas

__all__ = ["Facts", "compute_facts", "facts_of", "write_facts"]

_FILE = files("cg.catalogue") / "facts.json"


@dataclass(frozen=True)
class Facts:
    """A method in numbers.

    Attributes
    ----------
    name : str
    kind : str
        ``"Crouch-Grossman"``, ``"implicit"``, ``"commutator-free"`` or ``"Munthe-Kaas"``.
    order, embedded_order : int, int or None
        `Method.order`, and that of the second result of a pair.
    approximate : bool
        Whether the order is only nominal.
    evaluations, flows, pair_flows : int
        A step, and a step of a pair with its estimate.
    principal_error : float or None
        `Method.principal_error`; None beyond the orders that conditions are known of.
    real_stability, imaginary_stability : float or None
        `cg.method.stability.stability_limits`; None if there is no end.
    not_computed : str or None
        What wasn't computed and is None for that, and why.
    """

    name: str
    kind: str
    order: int
    embedded_order: int | None
    approximate: bool
    evaluations: int
    flows: int
    pair_flows: int
    principal_error: float | None
    real_stability: float | None
    imaginary_stability: float | None
    not_computed: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can hold."""
        return asdict(self)


def compute_facts(method: Method) -> Facts:
    """Compute the summary of a method; for high orders it takes seconds."""
    left_out = too_large(method)
    real = imaginary = None
    if left_out is None:
        limits = stability_limits(method)
        real, imaginary = _finite(limits.real), _finite(limits.imaginary)
    principal = None
    if method.order < MAX_ORDER:
        principal = _short(method.principal_error())
    return Facts(
        method.name,
        _kind(method),
        method.order,
        method.embedded_order,
        method.approximate,
        method.stages,
        method.exponentials,
        method.pair_exponentials,
        principal,
        real,
        imaginary,
        left_out,
    )


def facts_of(method: Method) -> Facts:
    """Return the summary of a method: the stored one if the method is in the catalogue."""
    for catalogue in (methods, munthe_kaas):
        if method.name in catalogue and catalogue[method.name] == method:
            return _kept().get(method.name) or compute_facts(method)
    return compute_facts(method)


def write_facts(path: Any) -> None:
    """Write what there is to say of all methods of the catalogue."""
    entries = [compute_facts(m).as_dict() for c in (methods, munthe_kaas) for m in c.values()]
    lines = ",\n".join(json.dumps(entry, ensure_ascii=False) for entry in entries)
    write_file(path, f"[\n{lines}\n]\n")


@cache
def _kept() -> dict[str, Facts]:
    entries = json.loads(_FILE.read_text(encoding="utf-8")) if _FILE.is_file() else []
    return {entry["name"]: Facts(**entry) for entry in entries}


def _kind(method: Method) -> str:
    if isinstance(method, MuntheKaas):
        return "Munthe-Kaas"
    if isinstance(method, CommutatorFree):
        return "commutator-free"
    return "Crouch-Grossman" if method.explicit else "implicit"


def _finite(x: float) -> float | None:
    return _short(x) if math.isfinite(x) else None


def _short(x: float) -> float:
    return float(f"{x:.4g}")
