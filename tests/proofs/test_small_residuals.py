"""Certificates of conditions that are shown to be small, not zero."""

from dataclasses import replace
from decimal import Decimal

import pytest
from flint import arb
from refusals import refuses

import cg
from cg.construction.catalogue import methods
from cg.construction.conditions.words import Condition, parse
from cg.construction.proofs import Certificate, CertificationError, certificate_of, certify, check
from cg.construction.proofs.digits import max_digits
from cg.construction.proofs.krawczyk import enclose_zero, krawczyk
from cg.construction.proofs.packed import fitting
from cg.support.balls import working_precision as precision


def changed(certificate, **changes):
    return replace(certificate, box=replace(certificate.box, **changes))


def test_dependent_conditions_are_below_a_bound():
    method = methods["CG5a"]
    certificate = certificate_of(method)
    left_out = certificate.left_out
    assert f"all but {len(left_out)} of the independent conditions" in str(certificate)
    assert "the residuals of the rest are below 1e-300" in str(certificate)
    assert Certificate.loads(certificate.dumps()) == certificate
    for bound in ("1e-20", "0", "-1e-50"):
        with pytest.raises(CertificationError):
            changed(certificate, bound=Decimal(bound))
    for wrong in ((*left_out, Condition(0, ())), (*left_out, left_out[0]), left_out[1:]):
        with pytest.raises(CertificationError):
            check(changed(certificate, left_out=wrong), method)


@pytest.mark.parametrize("name", ["CG4", "CG5a", "DICG4", "CF5r"])
def test_bounds_are_tight_and_limit_the_digits(name):
    """Where residuals are quadratic in the distance from a solution, they are no smaller."""
    method = methods[name]
    certificate = certify(method)
    assert certificate == certificate_of(method)
    assert not certificate.complete
    check(certificate, method)
    bound = certificate.box.bound
    assert (bound == Decimal("1e-300")) == (name not in ("CG4", "CF5r"))
    if bound > Decimal("1e-300"):
        with pytest.raises(CertificationError, match="small is not proved"):
            check(changed(certificate, bound=bound / 1000), method)
    refuses(CertificationError, "orthogonality explains", certify, method, complete=True)
    most = max_digits(certificate)
    assert most == -bound.adjusted() // 2
    assert cg.digits(method, most, certificate=certificate)
    with pytest.raises(CertificationError, match=f"at most {most}, got {most + 1}"):
        cg.digits(method, most + 1, certificate=certificate)
    assert cg.export(method, "json", digits=most, certificate=certificate)
    with pytest.raises(ValueError, match=f"at most {most}, since .* small; got {most + 1}"):
        cg.export(method, "json", digits=most + 1, certificate=certificate)


def test_an_independent_condition_is_not_as_small():
    """Its residual is 1e-36, the rounding of coefficients, not that of a zero of the others."""
    method = methods["CG4a"]
    certificate = certify(method)
    movable = [name for name in method.layout.names if name not in certificate.fixed]
    wrong = changed(
        certificate, left_out=(Condition(0, parse("[[[[[]]]]]")),), bound=Decimal("1e-41"),
        fixed=(*certificate.fixed, movable[0]),
    )  # fmt: skip
    refuses(CertificationError, "that conditions are small is not proved", check, wrong, method)


def test_where_the_zero_is():
    """Balls around the zero of a wide box lie in those of a narrow one."""
    method = methods["CG4a"]
    certificate = certify(method)
    packed = fitting(certificate, method)
    system, movable = packed.system(), packed.movable(certificate.box)
    with precision(1000):
        balls = packed.balls()
        wide, narrow = (
            enclose_zero(system, balls, movable, krawczyk(system, balls, movable, arb(r)), places)
            for r, places in (("1e-12", 60), ("1e-35", 250))
        )
        assert all(wide[k].contains(narrow[k]) for k in movable)
        assert max(float(narrow[k].rad()) for k in movable) < 1e-250
        assert all(abs(value) < arb("1e-248") for value in system.residuals(narrow))
        none = krawczyk(system, packed.balls(), movable, arb("1e-40"))
        with pytest.raises(CertificationError, match="no zero is proved"):
            enclose_zero(system, packed.balls(), movable, none, 60)
    with precision(200):
        test = krawczyk(system, packed.balls(), movable, arb("1e-35"))
        with pytest.raises(CertificationError, match="100 places aren't proved"):
            enclose_zero(system, packed.balls(), movable, test, 100)


@pytest.mark.parametrize("name", ["CG3", "CF5c"])
def test_complete_proofs(name):
    assert certify(name, complete=True).complete
