"""LaTeX tables of methods for the package booktabs."""

from collections.abc import Iterator, Sequence
from fractions import Fraction

from cg.construction.formats.digits import Numbers
from cg.construction.methods.coefficients import Coefficient
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.methods.method import Method
from cg.support.quads import DECIMAL_DIGITS, to_decimal

_MAX_WIDTH = 110
"""Largest number of characters in a row of a tableau; a wider one becomes a list of its entries."""

_MAX_ROWS = 40  # longest table that stays on one page

_MAX_INTEGER_BITS = 10_000  # longest integer that is written; Python's limit is 4300 decimal digits


def to_latex(numbers: Numbers) -> str:
    """Return a table, after a comment that names the method and the required packages."""
    method = numbers.rounded(zeros=True)
    if isinstance(method, CommutatorFree):
        table = _points(method)
    else:
        rows = list(_entries(method, numbers))
        texts = [[_number(entry) if entry else "" for entry in row] for row in rows]
        widest = max(sum(map(len, row)) for row in texts)
        table = _list(rows, method) if widest > _MAX_WIDTH else _butcher(texts, method)
    needs = r"% \usepackage{booktabs}"
    if "longtable" in table:
        needs += r", \usepackage{longtable}"
    return f"% Method {numbers.heading.splitlines()[0]}\n{needs}\n{table}\n"


def _entries(method: Method, numbers: Numbers) -> Iterator[list[Coefficient | None]]:
    """Yield the rows of a tableau, abscissae first, None for zeros of its shape."""
    summed = method.layout.full_rows(numbers.values)
    rows = [list(row) for row in method.layout.full_rows(method.coefficients)]
    if method.third_weights is not None:
        rows.append(list(method.third_weights))
    for i, row in enumerate(rows):
        entries = [Coefficient.read(entry) for entry in row]
        if i >= method.stages:
            yield [None, *entries]
            continue
        total = Fraction(sum(summed[i]))
        bits = max(x.bit_length() for x in total.as_integer_ratio())
        if bits > _MAX_INTEGER_BITS or any(set(entry.text) & set(".ex") for entry in entries):
            # The sum is written as a decimal, as entries are.
            digits = numbers.digits
            text = to_decimal(total, digits or DECIMAL_DIGITS, zeros=digits is not None)
            first = Coefficient(total, text, Fraction(1))
        else:
            first = Coefficient.read(total)
        above = len(row) - i if method.explicit else 0
        yield [first, *entries[: len(row) - above], *[None] * above]


def _butcher(rows: list[list[str]], method: Method) -> str:
    s = method.stages
    lines = [" & ".join(f"${entry}$" if entry else "" for entry in row) + r" \\" for row in rows]
    return _table("r@{\\qquad}" + "r" * s, lines[:s], lines[s:])


def _list(rows: list[list[Coefficient | None]], method: Method) -> str:
    """Return a table of the nonzero coefficients of a tableau, one a row."""
    labels = [f"a_{{{i}," for i in range(1, method.stages + 1)]
    labels += ["b_{", r"\hat b_{", r"\tilde b_{"]
    lines = [
        f"${label}{j}}}$ & ${_number(entry)}$ \\\\"
        for label, row in zip(labels, rows, strict=False)
        for j, entry in enumerate(row[1:], 1)
        if entry is not None and entry.value
    ]
    return _table("ll", [r"Coefficient & Value \\"], lines)


def _points(method: CommutatorFree) -> str:
    """Return a table of the points of a step: parent, weights and role of each."""
    roles = method.tree.roles()
    lines = [f"$0$ & & & & {', '.join(roles.get(-1, []))} \\\\"]
    pairs = zip(method.points, method.point_coefficients, strict=True)
    for m, (point, weights) in enumerate(pairs):
        first = f"${m + 1}$ & ${point.parent + 1}$"
        role = ", ".join(roles.get(m, []))
        lines.append(r"\addlinespace")
        for stage, weight in weights.items():
            lines.append(f"{first} & ${stage + 1}$ & ${_number(weight)}$ & {role} \\\\")
            first, role = " & ", ""
    if method.third_weights is not None:
        lines.append(r"\addlinespace")
        lines += [
            f" & & ${stage}$ & ${_number(weight)}$ & third weights \\\\"
            for stage, weight in enumerate(method.third_weights, 1)
            if weight.value
        ]
    head = r"Point & From & Stage & Weight & Evaluated as \\"
    return _table("rrrll", [head], lines)


def _table(columns: str, head: Sequence[str], lines: Sequence[str]) -> str:
    long = len(lines) > _MAX_ROWS
    environment = "longtable" if long else "tabular"
    return "\n".join([
        f"\\begin{{{environment}}}{{{columns}}}", r"\toprule", *head,
        r"\midrule", *[r"\endhead"] * long, *lines, r"\bottomrule", f"\\end{{{environment}}}",
    ])  # fmt: skip


def _number(entry: Coefficient) -> str:
    if entry.text.lstrip("-").startswith("0x"):  # a double in hexadecimal
        return _power(to_decimal(entry.value, 17))
    numerator, slash, denominator = entry.text.partition("/")
    if not slash:
        return _power(entry.text)
    sign = "-" if numerator.startswith("-") else ""
    return f"{sign}\\frac{{{numerator.lstrip('-')}}}{{{denominator}}}"


def _power(text: str) -> str:
    significand, e, exponent = text.lower().partition("e")
    return f"{significand}\\cdot 10^{{{int(exponent)}}}" if e else text
