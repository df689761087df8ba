"""Polynomials with rational coefficients, how they are written, and calls of Singular."""

import re
import subprocess
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from flint import Ordering, fmpq, fmpq_mpoly_ctx

from cg.support.quads import to_flint

Polynomial = Any  # a flint.fmpq_mpoly

_TERM = re.compile(r"([+-]?)([^+-]+)")
_NUMBER = re.compile(r"\d+(/\d+)?")
_POWER = re.compile(r"([a-z]\w*)(?:\^(\d+))?", re.ASCII)


class Ring:
    """Polynomials in named unknowns over the rational numbers."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._context = fmpq_mpoly_ctx.get(self.names, Ordering.degrevlex)
        self._place = {name: k for k, name in enumerate(self.names)}
        self._unknowns = self._context.gens()

    def __getitem__(self, name: str) -> Polynomial:
        """Return an unknown; KeyError if there is none of this name."""
        return self._unknowns[self._place[name]]

    def number(self, value: Fraction | int | Polynomial) -> Polynomial:
        """Return a constant; a polynomial is returned as it is."""
        if isinstance(value, Fraction):
            return self._context.constant(to_flint(value))
        return self._context.constant(value) if isinstance(value, int) else value

    def read(self, text: str) -> Polynomial:
        """Return the polynomial in a text such as ``-3/2*x*y^2+7``; ValueError for other texts."""
        packed = "".join(text.split())
        terms: dict[tuple[int, ...], fmpq] = {}
        end = 0
        for match in _TERM.finditer(packed):
            if match.start() != end or (end and not match[1]):
                break
            end = match.end()
            exponents, coefficient = self._read_product(match[2])
            if match[1] == "-":
                coefficient = -coefficient
            terms[exponents] = terms.get(exponents, fmpq(0)) + coefficient
        if not packed or end != len(packed):
            raise ValueError(
                f"polynomial must be a sum of products, got {packed[end : end + 40]!r}"
            )
        return self._context.from_dict(terms)

    def _read_product(self, product: str) -> tuple[tuple[int, ...], fmpq]:
        exponents, coefficient = [0] * len(self.names), fmpq(1)
        for factor in product.split("*"):
            power = _POWER.fullmatch(factor)
            if _NUMBER.fullmatch(factor):
                value = Fraction(factor)
                coefficient *= to_flint(value)
            elif power and power[1] in self._place:
                exponents[self._place[power[1]]] += int(power[2] or 1)
            else:
                raise ValueError(
                    f"factor must be a rational number or a power of one of "
                    f"{', '.join(self.names)}, got {factor!r}"
                )
        return tuple(exponents), coefficient


def singular(program: str, seconds: float) -> str:
    """Return what a program of Singular prints; RuntimeError if it complains."""
    run = subprocess.run(
        ["Singular", "-q"], input=program, capture_output=True, text=True, timeout=seconds,
        check=True,
    )  # fmt: skip
    if "?" in run.stdout:
        raise RuntimeError(f"Singular: {run.stdout[:300]}")
    return run.stdout
