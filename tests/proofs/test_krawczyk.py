"""Krawczyk's test on small systems without a zero or with two zeros."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from importlib.resources import files
from typing import Any

import pytest
from flint import arb, arb_mat
from independent_verifier import NotProvedError, verify
from kinds import FROZEN
from refusals import refuses
from slow_cases import slow

import cg
from cg.construction.proofs.digits import rounded_text
from cg.construction.proofs.krawczyk import krawczyk
from cg.support.quads import working_precision


@dataclass(frozen=True)
class Uncoupled:
    """Uncoupled equations f(x_i) = 0, with a tight enclosure of f'."""

    f: Callable[[arb], arb]
    slope: Callable[[arb], arb]
    size: int = 1

    def linearise(self, z):
        """Return values and derivatives, as `EquationSystem` does."""
        slopes = [
            [self.slope(x) if i == j else arb(0) for j in range(len(z))] for i, x in enumerate(z)
        ]
        return [self.f(x) for x in z], arb_mat(slopes)


@dataclass(frozen=True)
class AtPoint:
    """The same with derivatives at the middle of the box, which is wrong."""

    system: Any

    def linearise(self, z):
        """Return values and derivatives at the middle."""
        return self.system.linearise([x.mid() for x in z])


def attempt(system, y, radius, size=1):
    with working_precision(200):
        return krawczyk(system, [arb(y)] * size, list(range(size)), arb(radius))


def dropped(test):
    """Return whether the test would pass without its contraction."""
    return test.correction < float(test.radius)


def halved(test):
    """Return whether the test would pass with half of its contraction."""
    return test.correction / float(test.radius) + test.contraction / 2 < 1


def parabola(constant):
    return Uncoupled(lambda x: x * x + arb(constant), lambda x: 2 * x)


def flattening(n=60):
    """x - 0.3 - 0.9 ∫ (1 - (1 - x²)^n): its slope is 1 at 0 and soon 0.1, so no zero up to 1."""

    def integral(x):
        total, factor = arb(0), arb(1)
        for k in range(n + 1):  # derivatives of (1 - x²)^n
            total = total + factor * x ** (2 * k + 1) / (2 * k + 1)
            factor = -factor * (n - k) / (k + 1)
        return x - total

    def slope(x):
        most = abs(x).upper()
        least = arb(0) if x.contains(0) else abs(x).lower()
        bounds = [1 - arb("0.9") * (1 - (1 - u * u) ** n) for u in (least, most)]
        return bounds[0].union(bounds[1])

    return Uncoupled(lambda x: x - arb("0.3") - arb("0.9") * integral(x), slope)


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize(("constant", "y", "radius"), [
    ("0.001", "0.1", "0.06"),  # no zero
    ("1e-9", "1e-4", "9e-5"),
    ("-0.01", "0.11", "0.25"),  # two of them
    ("-1e-30", "1.1e-15", "2.5e-15"),
])  # fmt: skip
def test_the_contraction_is_needed(constant, y, radius, size):
    system = parabola(constant)
    test = attempt(system, y, radius, size)
    assert dropped(test)
    assert attempt(AtPoint(system), y, radius, size).proved
    assert not test.proved


@pytest.mark.parametrize("size", [1, 3])
def test_all_of_the_contraction_is_needed(size):
    system = flattening()
    with working_precision(200):
        # it increases, and is negative at the end: there is no zero
        assert system.slope(arb(0, 1)) > 0
        assert system.f(arb(1)) < 0
    test = attempt(system, "0", "1", size)
    assert halved(test)
    assert not test.proved


@pytest.mark.parametrize(("y", "radius"), [("1.4142", "1e-3"), ("1.4142135623", "1e-9")])
def test_a_zero_is_proved(y, radius):
    test = attempt(parabola("-2"), y, radius, 2)
    assert test.proved
    assert test.contraction > 0
    assert abs(test.ratio - test.correction / float(radius) - test.contraction) < 1e-12


def test_a_zero_outside_the_box_is_not_proved():
    assert not attempt(parabola("-2"), "1.4142", "1e-5").proved
    assert attempt(parabola("-2"), "1.4142", "1.5e-5").proved


@pytest.mark.parametrize("sign", [1, -1])
def test_digits_are_decided_at_both_ends_of_a_ball(sign):
    with working_precision(200):
        for middle, radius, digits, expected in (
            ("0.12345", "1e-9", 4, None),  # a tie, where the middle alone would be rounded
            ("0.1234500001", "1e-9", 4, None),
            ("0.1234500001", "1e-11", 4, "0.1235"),
            ("0.1234499999", "1e-11", 4, "0.1234"),
            ("0.99996", "1e-6", 4, "1"),
            ("0.99996", "1e-4", 4, None),
            ("0", "1e-40", 4, None),
        ):
            ball = (arb(middle) + arb(0, arb(radius).upper())) * sign
            text = None if expected is None else ("-" if sign < 0 else "") + expected
            assert rounded_text(ball, digits) == text


FOLDER = files("cg.construction.catalogue")
CERTIFICATES = {
    path.name: certificate
    for path in sorted((FOLDER / "certificates").iterdir(), key=lambda path: path.name)
    if path.name.removesuffix(".toml") in FROZEN
    and (certificate := tomllib.loads(path.read_text("utf-8")))["order"] < 8
    and certificate["name"] not in ("CG7a", "CG7b")  # and order eight: an hour
}


def method(name):
    return tomllib.loads((FOLDER / name).read_text("utf-8"))


LONG = [name for name, certificate in CERTIFICATES.items() if certificate["order"] > 5]


@pytest.mark.parametrize("name", [*(n for n in CERTIFICATES if n not in LONG), *slow(*LONG)])
def test_certificates_are_proved_a_second_way(name):
    with working_precision(53):
        verify(method(name), CERTIFICATES[name])


@pytest.mark.parametrize("name", ["CG4a.toml", "CF4.toml", "CG5(4).toml", "CG3.toml"])
def test_the_second_implementation_rejects_wrong_certificates(name):
    entry, certificate = method(name), CERTIFICATES[name]
    count, violated, outside = "as many unknowns", "a condition is violated", "isn't inside the box"
    radius = Fraction(certificate["radius"])  # zero of exact methods
    changes = [
        (count if radius else violated, {"order": certificate["order"] + 1}),
        (count if radius else violated, {"fixed": certificate["fixed"][1:]}),
        ("isn't violated by as much", {"beyond": {**certificate["beyond"], "bound": "10"}}),
        ("one of the next order", {"beyond": {**certificate["beyond"], "tree": "[[]]"}}),
        ("another name", {"name": "another"}),
        (count if radius else violated, {"left_out": {"trees": ["[[]]"]}}),
        *((outside, {"radius": r}) for r in (str(float(radius / 1000)), "0.1") if radius),
        (violated if radius else count, {"radius": "0" if radius else "1e-20"}),
    ]
    with working_precision(53):
        for message, change in changes:
            refuses(NotProvedError, message, verify, entry, {**certificate, **change})


def test_the_second_way_refuses_a_condition_left_out_too_many():
    """One more coefficient is fixed: the others have a zero, at which the residual isn't small."""
    certificate = CERTIFICATES["CF5d.toml"]
    trees = certificate["left_out"]["trees"]
    held = set(certificate["fixed"])
    movable = [name for name in cg.methods["CF5d"].layout.names if name not in held]
    changes = [
        ("inside the box", {"left_out": {"trees": [*trees, "[[]]"]}, "fixed": [*held, movable[0]]}),
        ("distinct independent ones", {"left_out": {"trees": [*trees, "[[][]]"]}}),
        ("as many unknowns", {"left_out": {"trees": trees[:-1]}}),
    ]
    with working_precision(53):
        for message, change in changes:
            refuses(NotProvedError, message, verify, method("CF5d.toml"), {**certificate, **change})


def test_which_certificates_are_proved_a_second_way():
    assert len(CERTIFICATES) > 50
    assert {"CG5(4).toml", "CG6b.toml", "CF4.toml", "DICG6.toml"} <= set(CERTIFICATES)
