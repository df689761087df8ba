"""Proofs that no method of a shape has an order, and the check of them.

By Hilbert's Nullstellensatz, polynomials f_k without common zero, over the complex numbers as well,
have polynomials g_k with Σ g_k f_k = 1. A proof is a list of such g_k. To check it is to multiply
out, in exact rational arithmetic.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from cg.construction.trees import OrderedTree
from cg.support.parsing import read_toml

from .ring import Polynomial, Ring
from .shapes import Shape, TableauShape, orderings, point_shapes, read_shape


class ImpossibilityError(ArithmeticError):
    """An identity of a proof doesn't hold; the message names it."""


@dataclass(frozen=True)
class Lemma:
    """A polynomial that is zero at all flat methods of the order."""

    polynomial: str
    factors: Mapping[str, str]  # factors of flat conditions, by tree, and of lemmas before


@dataclass(frozen=True)
class Claim:
    """That no method of a shape has an order: one is a combination of its conditions."""

    shape: str  # as for `read_shape`
    factors: Mapping[str, str]  # factors of conditions, by their trees, and of lemmas


@dataclass(frozen=True)
class Proof:
    """Claims about methods of one order, and lemmas that they share."""

    order: int
    stages: int  # number in tableaux and trees of points that claims are about, 0 if none are
    lemmas: tuple[Lemma, ...]
    claims: tuple[Claim, ...]

    def statements(self) -> list[str]:
        """Return the statements of the proof; `check_lemmas` and `check_claim` check them."""
        shapes = {claim.shape for claim in self.claims}
        said = []
        if "tableau" in shapes:
            what = f"Crouch-Grossman tableau of {self.stages} stages"
            said.append(f"no explicit {what} has order {self.order}")
        for shape in sorted(shape for shape in shapes if shape.startswith("path")):
            said.append(
                f"no explicit commutator-free method with a {shape} flows to its result has order "
                f"{self.order}"
            )
        trees = [str(shape) for shape in point_shapes(self.stages)] if self.stages else []
        ruled_out = shapes.intersection(trees)
        if ruled_out:
            which = "no tree" if len(ruled_out) == len(trees) else f"none of {len(ruled_out)} trees"
            said.append(f"{which} of {self.stages} points (of {len(trees)}) has order {self.order}")
        return said

    def check_lemmas(self) -> None:
        """Multiply out that the lemmas are combinations of the flat conditions.

        Raises
        ------
        ImpossibilityError
            If one of them isn't.
        """
        if not self.lemmas:
            return
        flat = TableauShape(self.stages)
        given = dict(_flat_conditions(self.stages, self.order))
        for number, lemma in enumerate(self.lemmas, 1):
            name = f"lemma {number}"
            polynomial = flat.ring.read(lemma.polynomial)
            if _combination(flat.ring, lemma.factors, given, name) != polynomial:
                raise ImpossibilityError(f"{name} isn't the combination it should be")
            given[name] = polynomial

    def check_claim(self, claim: Claim) -> None:
        """Multiply out that one is a combination of the conditions of a shape; raise if it isn't.

        Lemmas are used only after it is shown that flat conditions are sums of conditions.
        """
        shape = read_shape(claim.shape, self.stages)
        given = shape.conditions(self.order)
        if isinstance(shape, Shape) and self.lemmas:
            _check_flat(shape, given, _flat_conditions(self.stages, self.order))
            for number, lemma in enumerate(self.lemmas, 1):
                given[f"lemma {number}"] = shape.ring.read(lemma.polynomial)
        if _combination(shape.ring, claim.factors, given, f"shape {claim.shape}") != 1:
            raise ImpossibilityError(f"shape {claim.shape}: the combination isn't one")


def proof_names() -> list[str]:
    """Return the names of the proofs that the package has."""
    return sorted(entry.name[:-5] for entry in _folder().iterdir() if entry.name.endswith(".toml"))


def read_proof(name: str) -> Proof:
    """Return a proof of the package.

    Raises
    ------
    KeyError
        If there is none of this name.
    """
    if name not in proof_names():
        raise KeyError(f"there is no proof {name!r}; there are {', '.join(proof_names())}")
    table = read_toml((_folder() / f"{name}.toml").read_text(encoding="utf-8"), ImpossibilityError)
    return Proof(
        table["order"],
        table.get("stages", 0),
        tuple(Lemma(**entry) for entry in table.get("lemma", [])),
        tuple(Claim(**entry) for entry in table["claim"]),
    )


def check(name: str) -> list[str]:
    """Check a proof of the package, and return its statements.

    Parameters
    ----------
    name : str
        One of `proof_names`.

    Raises
    ------
    KeyError
        If there is none of this name.
    ImpossibilityError
        If an identity doesn't hold.
    """
    proof = read_proof(name)
    proof.check_lemmas()
    for claim in proof.claims:
        proof.check_claim(claim)
    return proof.statements()


def _folder() -> Traversable:
    return files(__package__) / "proofs"


@cache
def _flat_conditions(stages: int, order: int) -> dict[str, Polynomial]:
    return TableauShape(stages).flat_conditions(order)


def _check_flat(shape: Shape, given: Mapping[str, Any], flat: Mapping[str, Any]) -> None:
    for tree, condition in flat.items():
        ordered = orderings(OrderedTree.parse(tree))
        terms = (count * given[f"[{t}]"] for t, count in ordered.items())
        if sum(terms, shape.ring.number(0)) != condition:
            raise ImpossibilityError(
                f"shape {shape}: the flat condition of {tree} isn't the sum of those of its orders"
            )


def _combination(
    ring: Ring, factors: Mapping[str, str], given: Mapping[str, Any], where: str
) -> Polynomial:
    total = ring.number(0)
    for name, factor in factors.items():
        if name not in given:
            raise ImpossibilityError(f"{where}: there is no condition or lemma {name!r}")
        try:
            total += ring.read(factor) * given[name]
        except ValueError as error:
            raise ImpossibilityError(f"{where}, factor of {name}: {error}") from None
    return total
