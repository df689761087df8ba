"""Certificates of orders, and their text files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Any

from cg.construction.conditions.exact import Condition, Word, parse, tree_text
from cg.support.parsing import check_keys, quoted, read_file, read_toml, write_file

MAX_SMALL = Decimal("1e-40")
"""Larger bounds don't tell conditions that hold from coefficients that are rounded."""

_MAX_ENTRY = Decimal("1e4000")  # more digits of an integer Python doesn't write by default

_KINDS: dict[str, type] = {
    "name": str,
    "order": int,
    "radius": str,
    "bits": int,
    "fixed": list,
    "beyond": dict,
}
_KINDS_OF_BEYOND: dict[str, type] = {"tree": str, "bound": str}
_TREES = "trees", "embedded_trees"  # by row of weights

_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,9})?", re.ASCII)


class CertificationError(ArithmeticError):
    """A proof that failed.

    Attributes
    ----------
    quantities
        Measured quantities by name: ``conditions``, ``rank``, ``smallest_singular_value``,
        ``residual``, ``allowed`` (that of the stored places), ``radius``, ``ratio``,
        ``correction``, ``contraction`` (see `cg.construction.proofs.krawczyk`), …

    Examples
    --------
    The paper's example of order six satisfies the conditions only approximately.

    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.certify("CG6a")
    ... except cg.CertificationError as error:
    ...     found, allowed = error.quantities["residual"], error.quantities["allowed"]
    ...     print(f"a residual of {found:.1e}, where its digits allow {allowed:.1e}")
    a residual of 6.4e-07, where its digits allow 4.8e-07
    """

    def __init__(self, message: str, **quantities: Any) -> None:
        texts = {k: f"{x:.3g}" if isinstance(x, float) else x for k, x in quantities.items()}
        details = ", ".join(f"{name.replace('_', ' ')} = {x}" for name, x in texts.items())
        super().__init__(f"{message} ({details})" if details else message)
        self.quantities = quantities


@dataclass(frozen=True)
class ViolatedCondition:
    """A condition by the word of its tree's children, for which ``|Φ(t) - 1/γ(t)| ≥ bound``."""

    word: Word
    bound: Decimal

    def __post_init__(self) -> None:
        _check_decimal(self.bound, "bound")

    @property
    def tree(self) -> str:
        """The tree in brackets."""
        return tree_text(self.word)


@dataclass(frozen=True)
class Box:
    """A box around the stored coefficients in which conditions have exactly one zero."""

    radius: Decimal  # 0 for rational methods, which satisfy the conditions themselves
    fixed: tuple[str, ...]  # names of the coefficients that are fixed, such as a_3,1
    left_out: tuple[Condition, ...] = ()  # independent conditions that aren't equations of the zero
    bound: Decimal | None = None  # bound of their residuals; None if they follow by orthogonality

    def __post_init__(self) -> None:
        _check_decimal(self.radius, "radius")
        if self.bound is not None:
            _check_decimal(self.bound, "bound")
            if not self.left_out or not 0 < self.bound <= MAX_SMALL:
                raise CertificationError(
                    f"the bound of conditions that are left out must be at most {MAX_SMALL:e}, "
                    f"got {_decimal(self.bound)} for {len(self.left_out)} conditions"
                )


@dataclass(frozen=True, kw_only=True)
class Certificate(Box):
    """A proved statement about a method, with the data to prove it again.

    In the box there is exactly one solution of the equations, and it satisfies all conditions
    through the order, or all but some that are tiny there.

    Attributes
    ----------
    name
        Name of the method.
    order
    embedded_order
        Order of the second weights of a pair, together with the same stages.
    bits
        Precision of the arithmetic.
    radius, fixed, left_out, bound
        See `Box`.
    beyond
        Why the order isn't higher.
    embedded_beyond
        Why that of the second weights isn't.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> proof = cg.certify("CG4a")
    >>> proof.order, proof.complete, proof.beyond.tree
    (4, True, '[[[[][[]]]]]')
    >>> float(proof.radius) < 1e-30
    True
    """

    name: str
    order: int
    embedded_order: int | None
    bits: int
    beyond: ViolatedCondition
    embedded_beyond: ViolatedCondition | None

    @property
    def orders(self) -> tuple[int, ...]:
        """The orders of all rows of weights."""
        return (self.order, *([] if self.embedded_order is None else [self.embedded_order]))

    @property
    def complete(self) -> bool:
        """Whether all conditions are proved; otherwise some are only shown to be small."""
        return self.bound is None

    @property
    def proved(self) -> str:
        """How much of the order is proved: ``"yes"``, or ``"in part"`` if not `complete`."""
        return "yes" if self.complete else "in part"

    @property
    def heading(self) -> str:
        """The statement proved, in a few words: ``"order 8 is proved"``, or ``"… in part"``."""
        pair = f"({self.embedded_order})" if self.embedded_order else ""
        return f"order {self.order}{pair} is proved{'' if self.complete else ' in part'}"

    @property
    def statement(self) -> str:
        """The statement proved, as a clause."""
        if not self.radius:
            return "the stored coefficients satisfy all order conditions exactly"
        exact = f"coefficients within {_decimal(self.radius)} of the stored ones satisfy all"
        if self.bound is None:
            return f"{exact} order conditions exactly"
        left, bound = len(self.left_out), _decimal(self.bound)
        return (
            f"{exact} but {left} of the independent conditions exactly; the residuals of the rest "
            f"are below {bound}"
        )

    def __str__(self) -> str:
        follows = ", with orthogonality" if self.left_out and self.complete else ""
        fixed = f"; of the coefficients {len(self.fixed)} are held fixed" if self.radius else ""
        return (
            f"{self.name or 'the method'}: {self.heading}: {self.statement}{follows}{fixed}; not "
            f"order {self.order + 1}: {self.beyond.tree} is off by at least "
            f"{_decimal(self.beyond.bound)}"
        )

    def dumps(self) -> str:
        """Write the certificate as TOML; `loads` gives an equal one back."""
        lines = [
            f"name = {quoted(self.name)}",
            f"order = {self.order}",
            f'radius = "{_decimal(self.radius)}"',
            f"bits = {self.bits}",
            f"fixed = {_wrapped(self.fixed)}",
        ]
        if self.left_out:
            lines += ["", "[left_out]"]
            if self.bound is not None:
                lines.append(f'bound = "{_decimal(self.bound)}"')
            for row, key in enumerate(_TREES):
                trees = [tree_text(word) for r, word in self.left_out if r == row]
                lines.append(f"{key} = {_wrapped(trees, 5)}")
        lines += ["", "[beyond]", *_beyond(self.beyond)]
        if self.embedded_beyond is not None:
            lines += ["", "[embedded]", f"order = {self.embedded_order}"]
            lines += _beyond(self.embedded_beyond)
        return "\n".join(lines) + "\n"

    @classmethod
    def loads(cls, text: str) -> Certificate:
        """Read what `dumps` writes; CertificationError if a key or a value is wrong."""
        if not isinstance(text, str):
            raise TypeError(f"text must be a str, got {text!r}")
        entry = read_toml(text, CertificationError)
        optional = {key: dict for key in ("left_out", "embedded") if key in entry}
        _check(entry, _KINDS | optional, "the certificate")
        embedded = entry.get("embedded")
        if embedded is not None:
            _check(embedded, _KINDS_OF_BEYOND | {"order": int}, "embedded")
        return cls(
            name=entry["name"],
            order=entry["order"],
            embedded_order=embedded.pop("order") if embedded else None,
            bits=entry["bits"],
            **vars(_read_box(entry)),
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
    check_keys(table, kinds, (), where, CertificationError)
    for key, kind in kinds.items():
        if type(table[key]) is not kind:
            raise CertificationError(
                f"{where}: {key} must be a {kind.__name__}, got {table[key]!r}"
            )


def _read_box(entry: dict[str, Any]) -> Box:
    left_out, bound = [], None
    if "left_out" in entry:
        table = entry["left_out"]
        optional: dict[str, type] = {"bound": str} if "bound" in table else {}
        _check(table, dict.fromkeys(_TREES, list) | optional, "left_out")
        left_out = [
            Condition(row, _read_tree(tree))
            for row, key in enumerate(_TREES)
            for tree in table[key]
        ]
        bound = _read_decimal(table, "bound") if optional else None
    fixed = tuple(map(str, entry["fixed"]))
    return Box(_read_decimal(entry, "radius"), fixed, tuple(left_out), bound)


def _read_beyond(table: dict[str, Any], where: str) -> ViolatedCondition:
    _check(table, _KINDS_OF_BEYOND, where)
    return ViolatedCondition(_read_tree(table["tree"]), _read_decimal(table, "bound"))


def _read_tree(tree: Any) -> Word:
    try:
        return parse(str(tree))
    except ValueError as error:
        raise CertificationError(str(error)) from None


def _read_decimal(table: dict[str, Any], key: str) -> Decimal:
    text = table[key]
    # other readers of numbers don't take all that `Decimal` does
    value = Decimal(text) if _PLAIN.fullmatch(text) else text
    return _check_decimal(value, key)


def _check_decimal(value: object, name: str) -> Decimal:
    if isinstance(value, Decimal) and (
        value.is_zero() or (value.is_finite() and 1 / _MAX_ENTRY <= value <= _MAX_ENTRY)
    ):
        return value
    raise CertificationError(
        f"{name} must be a decimal number, zero or between 1e-4000 and 1e4000, got "
        f"{str(value)[:80]!r}"
    )


def _decimal(value: Decimal) -> str:
    return str(value).lower()


def _beyond(violation: ViolatedCondition) -> list[str]:
    return [f'tree = "{violation.tree}"', f'bound = "{_decimal(violation.bound)}"']


def _wrapped(texts: Sequence[str], each: int = 10) -> str:
    lines = [", ".join(map(quoted, texts[k : k + each])) for k in range(0, len(texts), each)]
    return "[\n" + "".join(f"  {line},\n" for line in lines) + "]" if lines else "[]"
