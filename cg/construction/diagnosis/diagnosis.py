"""The result of diagnosing a method, and the functions that diagnose one, or a file."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

from cg.construction.catalogue import resolve_method
from cg.construction.catalogue.entries import check_path, errors_naming, from_entry, read_entry
from cg.construction.diagnosis.failing import FailingCondition, first_failing
from cg.construction.diagnosis.mistakes import Finding, recognise_all
from cg.construction.diagnosis.variants import order_on_vector_spaces
from cg.construction.methods.abscissae import read_abscissae
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.tableau import Tableau, TableauError
from cg.support.parsing import read_file, visible


@dataclass(frozen=True)
class Diagnosis:
    """Order, first violated order condition and known mistakes of a method.

    Attributes
    ----------
    method
    order
        Order on manifolds to the precision of the coefficients (`Method.exact_order`); for a method
        of Munthe-Kaas, the order of its tableau.
    flat_order
        Order on vector spaces, where flows commute.
    embedded_order
        Order of the second result of a pair.
    failing
        The first violated order condition; None if all conditions of the tabulated orders hold.
    findings
        Recognised mistakes, and the method of the catalogue with the same coefficients.

    Examples
    --------
    The midpoint rule, with the wrong weights:

    >>> import crouch_grossman as cg
    >>> diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], ["1/2", "1/2"], name="mine"))
    >>> diagnosis.order, str(diagnosis.failing.tree)
    (1, '[[[]]]')
    """

    method: Method
    order: int
    flat_order: int
    embedded_order: int | None
    failing: FailingCondition | None
    findings: tuple[Finding, ...]

    @property
    def mistakes(self) -> tuple[Finding, ...]:
        """The findings that are mistakes."""
        return tuple(finding for finding in self.findings if finding.mistake)

    def __str__(self) -> str:
        method = self.method
        flows = f"{method.exponentials} flows"
        kind = "explicit" if method.explicit else "implicit"
        lines = [
            f"{visible(method.name) or 'a method'}: {kind}, {method.stages} evaluations, {flows}"
        ]
        lines.append(f"order: {self._order}")
        if self.embedded_order is not None:
            lines.append(f"order of the second result: {self.embedded_order}")
        if method.approximate:
            assert method.nominal_residual is not None
            lines.append(
                f"nominal order: {method.nominal_order}, whose conditions it satisfies up to "
                f"{method.nominal_residual.text} only"
            )
        if self.failing is not None:
            lines += [
                f"first condition that fails, of order {self.failing.order} "
                f"({self.failing.failing} of {self.failing.of} do):",
                *(f"    {line}".rstrip() for line in str(self.failing).splitlines()),
            ]
        for finding in self.findings:
            lines.append(f"{'mistake' if finding.mistake else 'note'}: {finding.message}")
        if not self.mistakes:
            lines.append("no known mistake recognised")
        return "\n".join(lines)

    @property
    def _order(self) -> str:
        if isinstance(self.method, MuntheKaas):
            return f"{self.order}, of the tableau in a Lie algebra"
        same = "" if self.flat_order == self.order else f", {self.flat_order} where flows commute"
        return f"{self.order} on manifolds{same}"

    def as_dict(self) -> dict[str, Any]:
        """Return the diagnosis as a dict for JSON."""
        method = self.method
        return {
            "name": method.name,
            "kind": type(method).__name__,
            "explicit": method.explicit,
            "evaluations": method.stages,
            "flows": method.exponentials,
            "order": self.order,
            "flat_order": self.flat_order,
            "embedded_order": self.embedded_order,
            "nominal_order": method.nominal_order,
            "first_failing": None if self.failing is None else self.failing.as_dict(),
            "findings": [
                {"kind": f.kind, "mistake": f.mistake, "message": f.message} for f in self.findings
            ],
        }


def diagnose(method: str | Method, *, c: Sequence[Any] | None = None) -> Diagnosis:
    """Determine the order of a method and recognise known mistakes in its coefficients.

    Parameters
    ----------
    method
        A method, or the name of one in the catalogue.
    c
        Sequence of s numbers. Abscissae to compare the row sums of a with.

    Returns
    -------
    Diagnosis
        Printed, it shows the order, the first violated order condition with its tree, and the
        mistakes recognised: reversed flows of stages, a transposed, one or two coefficients changed
        in a method of the catalogue, one wrong coefficient of another method with the value that it
        should have, truncated coefficients, rounded numbers given as exact fractions, second
        weights equal to the first, rows that don't sum to c, and a classical tableau used on
        manifolds without lifting.

    Raises
    ------
    ValueError
        If no method has that name, or `c` isn't a sequence of s numbers.
    TypeError
        If `method` is neither a name nor a method.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> heun = cg.Tableau([[], ["1/3"], [0, "2/3"]], ["1/4", 0, "3/4"], name="Heun's third")
    >>> diagnosis = cg.diagnose(heun)
    >>> diagnosis.order, diagnosis.flat_order, [mistake.kind for mistake in diagnosis.mistakes]
    (2, 3, ['flat'])
    >>> print(diagnosis.failing)
    ●
    ├── ●
    └── ●
        └── ●
    [[][[]]]  Φ = 0.3125, 1/γ = 1/3, off by -0.0208
    """
    method = resolve_method(method)
    if isinstance(method, MagnusMethod):
        raise TypeError(f"method must be for nonlinear equations, got {method!r}")
    if isinstance(method, Splitting):
        raise TypeError(
            "method must not be a splitting method, whose conditions are listed by "
            f"`crouch-grossman show --conditions`, got {method!r}"
        )
    abscissae = None if c is None else read_abscissae(c, method)
    return Diagnosis(
        method,
        method.exact_order,
        method.exact_order if isinstance(method, MuntheKaas) else order_on_vector_spaces(method),
        method.embedded_order,
        first_failing(method),
        tuple(recognise_all(method, abscissae)),
    )


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Diagnose the method in a file; unlike `cg.load`, accept wrong ``c`` and equal weights."""
    path = check_path(path)
    with errors_naming(path):
        return diagnose_entry(read_entry(read_file(path, TableauError)), path.stem)


def diagnose_entry(entry: dict[str, Any], name: str = "") -> Diagnosis:
    """Diagnose the method in the keys and values of a file; see `diagnose_file`."""
    entry = dict(entry)
    c = entry.pop("c", None)
    try:
        method = from_entry(entry, name)
    except TableauError:
        if "b_embedded" not in entry or not _same(entry["b"], entry["b_embedded"]):
            raise
        entry.pop("b_embedded")
        diagnosis = diagnose(from_entry(entry, name), c=c)
        finding = Finding(
            "equal weights",
            "b_embedded equals b: the difference of the results is zero and estimates no error",
        )
        return replace(diagnosis, findings=(finding, *diagnosis.findings))
    return diagnose(method, c=c)


def _same(b: Any, second: Any) -> bool:
    # compare values, since texts such as 1/2 and 0.5 differ
    stages = len(b) if isinstance(b, list) else 0
    zeros = [[0] * stages] * stages
    return Tableau(zeros, b).exact[1] == Tableau(zeros, second).exact[1]
