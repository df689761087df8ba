"""Certificates of orders, and their text files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

from ..support.parsing import quoted, read_file, read_fraction, read_toml, write_file

_LARGEST = Fraction(10) ** 4000  # more digits of an integer Python doesn't write by default


class CertificationError(ArithmeticError):
    """A proof that failed.

    Attributes
    ----------
    quantities : dict
        Measured quantities by name: ``conditions``, ``rank``, ``singular_values`` (the
        smallest), ``residual`` and what the stored places ``allow``, ``radius``,
        ``ratio``, ``correction``, ``contraction`` (see `cg.proofs.krawczyk`), …

    Examples
    --------
    The paper's example of order six satisfies the conditions only approximately.

    >>> import cg
    >>> try:
    ...     cg.certify("CG6a")
    ... except cg.CertificationError as error:
    ...     found, allowed = error.quantities["residual"], error.quantities["allowed"]
    ...     print(f"a residual of {found:.1e}, where its digits allow {allowed:.1e}")
    a residual of 6.4e-07, where its digits allow 4.8e-07
    """

    def __init__(self, message: str, **quantities: Any) -> None:
        details = ", ".join(
            f"{name.replace('_', ' ')} = {value:.3g}"
            if isinstance(value, float)
            else f"{name.replace('_', ' ')} = {value}"
            for name, value in quantities.items()
        )
        super().__init__(f"{message} ({details})" if details else message)
        self.quantities = quantities


@dataclass(frozen=True)
class ViolatedCondition:
    """A violated condition of the next order.

    Attributes
    ----------
    tree : str
        In brackets.
    bound : str
        Decimal; ``|Φ(t) - 1/γ(t)|`` is at least this for the exact solution.
    """

    tree: str
    bound: str

    def __post_init__(self) -> None:
        _decimal(self.bound)


@dataclass(frozen=True)
class Certificate:
    """A proved statement about a method, with the data to prove it again.

    In the box of this radius around the stored coefficients, with the fixed ones held at
    their stored values, there is exactly one solution of the equations, and it satisfies
    all conditions through the order.

    Attributes
    ----------
    name : str
        Of the method.
    order : int
    embedded_order : int or None
        Of the second weights of a pair, together with the same stages.
    radius : str
        Decimal; "0" for rational methods, which satisfy the conditions themselves.
    bits : int
        Precision of the arithmetic.
    identities : tuple of str
        Identities, structures and left-out conditions; or conditions that are only shown to be
        small, with a bound.
    fixed : tuple of str
        The coefficients that are held, such as ``a_3,1``, ``b_2`` and ``b_embedded_2``.
    beyond : ViolatedCondition
        Why the order isn't higher.
    embedded_beyond : ViolatedCondition or None
        Why that of the second weights isn't.

    Examples
    --------
    >>> import cg
    >>> proof = cg.certify("CG4a")
    >>> proof.order, proof.complete, proof.beyond.tree
    (4, True, '[[[[][[]]]]]')
    >>> float(proof.radius) < 1e-30
    True
    """

    name: str
    order: int
    embedded_order: int | None
    radius: str
    bits: int
    identities: tuple[str, ...]
    fixed: tuple[str, ...]
    beyond: ViolatedCondition
    embedded_beyond: ViolatedCondition | None

    def __post_init__(self) -> None:
        _decimal(self.radius)
        if not isinstance(self.bits, int) or isinstance(self.bits, bool):
            raise CertificationError(f"bits must be an integer, got {self.bits!r}")

    @property
    def complete(self) -> bool:
        """Whether all conditions are proved; otherwise some are only shown to be small."""
        return not any(name.startswith("only small") for name in self.identities)

    @property
    def proved(self) -> str:
        """How much of the order is proved: ``"yes"``, or ``"in part"`` if not `complete`."""
        return "yes" if self.complete else "in part"

    @property
    def heading(self) -> str:
        """What is proved, in a few words: ``"order 8 is proved"``, or ``"… in part"``."""
        pair = f"({self.embedded_order})" if self.embedded_order else ""
        return f"order {self.order}{pair} is proved{'' if self.complete else ' in part'}"

    @property
    def statement(self) -> str:
        """What is proved, in a clause."""
        if Fraction(self.radius) == 0:
            return "the stored coefficients satisfy all order conditions exactly"
        exact = f"coefficients within {self.radius} of the stored ones satisfy all"
        if self.complete:
            return f"{exact} order conditions exactly"
        bound, _, trees = self.identities[0].removeprefix("only small, ").partition(":")
        left = len(trees.split())
        return f"{exact} but {left} of the independent conditions exactly, and those are {bound}"

    def __str__(self) -> str:
        names = [name.partition(":")[0] for name in self.identities] if self.complete else []
        identities = f", with {' and '.join(names)}" if names else ""
        number = len(self.fixed)
        coefficients = "coefficient is" if number == 1 else "coefficients are"
        held = f"; {number} {coefficients} held fixed" if Fraction(self.radius) else ""
        return (
            f"{self.name or 'the method'}: {self.heading}: {self.statement}{identities}{held}; "
            f"not order {self.order + 1}: {self.beyond.tree} is off by at least {self.beyond.bound}"
        )

    def dumps(self) -> str:
        """Write the certificate as TOML; `loads` gives an equal one back."""
        lines = [
            f"name = {quoted(self.name)}",
            f"order = {self.order}",
            f'radius = "{self.radius}"',
            f"bits = {self.bits}",
            f"identities = [{', '.join(map(quoted, self.identities))}]",
            f"fixed = {_wrapped(self.fixed)}",
            "",
            "[beyond]",
            *_beyond(self.beyond),
        ]
        if self.embedded_beyond is not None:
            lines += ["", "[embedded]", f"order = {self.embedded_order}"]
            lines += _beyond(self.embedded_beyond)
        return "\n".join(lines) + "\n"

    @classmethod
    def loads(cls, text: str) -> Certificate:
        """Read what `dumps` writes.

        Raises
        ------
        CertificationError
            If a key is missing, unknown, or has a value of the wrong kind.
        TypeError
            If `text` isn't a str.
        """
        if not isinstance(text, str):
            raise TypeError(f"text must be a str, got {text!r}")
        entry = read_toml(text, CertificationError)
        kinds: dict[str, type] = {
            "name": str,
            "order": int,
            "radius": str,
            "bits": int,
            "identities": list,
            "fixed": list,
            "beyond": dict,
        }
        pair = {"embedded": dict} if "embedded" in entry else {}
        _check(entry, kinds | pair, "the certificate")
        embedded = entry.get("embedded")
        if embedded is not None:
            _check(embedded, {"order": int, "tree": str, "bound": str}, "embedded")
        return cls(
            name=entry["name"],
            order=entry["order"],
            embedded_order=embedded.pop("order") if embedded else None,
            radius=entry["radius"],
            bits=entry["bits"],
            identities=tuple(map(str, entry["identities"])),
            fixed=tuple(map(str, entry["fixed"])),
            beyond=_read_beyond(entry["beyond"], "beyond"),
            embedded_beyond=_read_beyond(embedded, "embedded") if embedded else None,
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the certificate to a file."""
        write_file(path, self.dumps())

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Certificate:
        """Read a certificate from a file, as `loads`; OSError if there is none."""
        try:
            return cls.loads(read_file(Path(path), CertificationError))
        except CertificationError as error:
            raise CertificationError(f"{path}: {error}") from None


def _check(table: dict[str, Any], kinds: dict[str, type], where: str) -> None:
    if missing := sorted(set(kinds) - set(table)):
        raise CertificationError(f"{where} lacks {', '.join(missing)}")
    if unknown := sorted(set(table) - set(kinds)):
        raise CertificationError(f"{where} has unknown keys: {', '.join(unknown)}")
    for key, kind in kinds.items():
        if type(table[key]) is not kind:
            raise CertificationError(
                f"{where}: {key} must be a {kind.__name__}, got {table[key]!r}"
            )


def _read_beyond(table: dict[str, Any], where: str) -> ViolatedCondition:
    _check(table, {"tree": str, "bound": str}, where)
    return ViolatedCondition(table["tree"], table["bound"])


_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def _decimal(text: str) -> str:
    try:
        value = read_fraction(text)
        if not _PLAIN.fullmatch(text):  # what other readers of numbers don't take
            raise ValueError
        if value == 0 or 1 / _LARGEST <= value <= _LARGEST:
            return text
    except (TypeError, ValueError, ZeroDivisionError):
        pass
    raise CertificationError(
        f"expected a decimal number, zero or between 1e-4000 and 1e4000, got {str(text)[:80]!r}"
    )


def _beyond(violation: ViolatedCondition) -> list[str]:
    return [f'tree = "{violation.tree}"', f'bound = "{violation.bound}"']


def _wrapped(names: tuple[str, ...]) -> str:
    lines = [", ".join(map(quoted, names[k : k + 10])) for k in range(0, len(names), 10)]
    return "[\n" + "".join(f"  {line},\n" for line in lines) + "]" if lines else "[]"
