"""Comparison of given abscissae with the row sums of a method."""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from cg.construction.methods.coefficients import Coefficient, read_row
from cg.construction.methods.method import Method


def read_abscissae(c: Sequence[Any], method: Method) -> tuple[Coefficient, ...]:
    """Return abscissae, one for each stage; raise MethodError if they are something else."""
    return read_row(c, "c", method.stages, "c_{}")


def wrong_abscissae(method: Method, c: Sequence[Coefficient]) -> Iterator[str]:
    """Yield a sentence for each abscissa that isn't the sum of its row, up to rounding."""
    for i, (expected, row) in enumerate(zip(c, method.exact[0], strict=False), 1):
        total = sum(row, Fraction(0))
        # the uncertainties of the entries add up
        allowed = expected.unit + sum((k.unit for k in method.coefficients), Fraction(0))
        if abs(expected.value - total) > allowed:
            yield (
                f"row {i} of a sums to {_short(total)}, not to c_{i} = {expected.text}: "
                f"off by {float(total - expected.value):.3g}"
            )


def _short(value: Fraction) -> str:
    # Python may be unable to write a longer one
    text = str(value) if value.denominator.bit_length() <= 64 else ""
    return text if 0 < len(text) <= 12 else f"{float(value):.16g}"
