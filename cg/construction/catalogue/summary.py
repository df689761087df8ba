"""One-line summary of each method; those of the catalogue are stored in ``summaries.json``."""

import json
import math
from dataclasses import asdict, dataclass
from typing import Any

from cg.construction.catalogue import find_method, methods
from cg.construction.conditions import MAX_ORDER
from cg.construction.methods.commutator_free import CommutatorFree, MuntheKaas
from cg.construction.methods.estimate import estimate_ratio
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.stability import reason_without_limits, stability_limits
from cg.support.parsing import write_file

_KINDS: dict[type, str] = {
    MuntheKaas: "Munthe-Kaas", MagnusMethod: "Magnus", Splitting: "splitting",
    CommutatorFree: "commutator-free",
}  # fmt: skip
_NO_LIMITS = "limits of stability, which are those of y' = λ y, no mechanical system"


@dataclass(frozen=True)
class MethodSummary:
    """Order, cost, error and stability; a number is None if it is infinite or doesn't exist."""

    name: str
    kind: str
    order: int
    embedded_order: int | None
    approximate: bool  # whether the order is only nominal
    evaluations: int
    flows: int
    pair_flows: int  # flows of a step with its error estimate
    estimate_ratio: float | None
    principal_error: float | None  # four digits, as the limits of stability
    real_stability: float | None
    imaginary_stability: float | None
    not_computed: str | None = None  # why there are no limits of stability

    @property
    def all_flows(self) -> str:
        """Flows of a step, in brackets those with the error estimate if it needs more."""
        return str(self.flows) + f"({self.pair_flows})" * (self.pair_flows != self.flows)


def compute_summary(method: Method) -> MethodSummary:
    """Compute the summary of a method; for high orders it takes seconds."""
    # a Magnus method solves the test equation exactly, and a splitting method doesn't apply to it
    magnus, splitting = isinstance(method, MagnusMethod), isinstance(method, Splitting)
    not_computed = _NO_LIMITS if splitting else None if magnus else reason_without_limits(method)
    tableau = "Crouch-Grossman" if method.explicit else "implicit"
    real = imaginary = principal = None
    ratio = estimate_ratio(method)
    if not_computed is None and not magnus:
        limits = stability_limits(method)
        real, imaginary = _finite(limits.real), _finite(limits.imaginary)
    if method.order < MAX_ORDER or splitting:
        principal = _finite(method.principal_error)  # huge coefficients overflow
    return MethodSummary(
        name=method.name,
        kind=next((name for kind, name in _KINDS.items() if isinstance(method, kind)), tableau),
        order=method.order, embedded_order=method.embedded_order, approximate=method.approximate,
        evaluations=method.stages, flows=method.exponentials, pair_flows=method.pair_exponentials,
        estimate_ratio=None if ratio is None else float(f"{ratio:.3g}"), principal_error=principal,
        real_stability=real, imaginary_stability=imaginary, not_computed=not_computed,
    )  # fmt: skip


def summary_of(method: Method) -> MethodSummary:
    """Return the summary of a method; that of a method in the catalogue is stored."""
    stored = methods.summaries.get(method.name) if find_method(method.name) == method else None
    return MethodSummary(**stored) if stored else compute_summary(method)


def write_summaries(path: Any) -> None:
    """Write the summaries of all methods in the catalogue to a JSON file."""
    entries = [asdict(compute_summary(methods.read_again(name))) for name in methods]
    lines = ",\n".join(json.dumps(entry, ensure_ascii=False) for entry in entries)
    write_file(path, f"[\n{lines}\n]\n")


def _finite(x: float) -> float | None:
    return float(f"{x:.4g}") if math.isfinite(x) else None
