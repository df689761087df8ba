from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import pytest
from flint import arb
from kinds import FROZEN, MAGNUS, SPLITTING
from refusals import refuses
from slow_cases import slow

import cg
from cg import conditions
from cg.construction import proofs as pf
from cg.construction.catalogue import methods
from cg.construction.conditions import Rows
from cg.construction.conditions.exact import Condition, parse
from cg.construction.methods.tableau import Tableau
from cg.construction.proofs import Certificate, CertificationError, certificate_of, certify, check
from cg.construction.proofs.digits import max_digits
from cg.construction.proofs.krawczyk import enclose_zero, krawczyk
from cg.construction.proofs.packed import certificate_names, fitting, folder
from cg.support.quads import working_precision

CERTIFIED = certificate_names()
ALL = {**FROZEN, **MAGNUS, **SPLITTING}
PARTLY = {
    "CG4", "CG4c", "CG5a", "CG5b", "CG5c", "CG5d", "CG5e", "CG6c", "CG6d", "CG6e", "CG6f", "CG6g",
    "CG6(5)", "CG7b", "CF5r", "CF6(5)", "CF7b", "CF7(6)", "CF8a", "DICG4", "DICG4c", "DICG6",
    "DP5(4)", "CooperVerner8", "Verner7(6)", "DOP853", "CFM8(4)", "Magnus8(4)",
}  # fmt: skip
PROVED_HERE = ["LieEuler", "CG2", "CG3", "CG2(3)", "CG4", "CG4a", "CG5a", *SPLITTING]
PROVED_HERE += sorted(MAGNUS.keys() - {"Magnus8(4)"})
LONG = ["Magnus8(4)", *(n for n, m in FROZEN.items() if m.stages > 9 or m.order > 6)]


def search(**arguments):
    return cg.search(**{"starts": 4, "seed": 0, **arguments}).methods[0]


def perturbed(method, name, change):
    texts, k = [x.text for x in method.coefficients], method.layout.names.index(name)
    texts[k] = cg.support.quads.to_decimal(method.coefficients[k].value + Fraction(change), 36)
    return method.with_coefficients(texts)


class TestProofs:
    @pytest.mark.parametrize(
        "name", [name if name not in LONG else slow(name)[0] for name in CERTIFIED]
    )
    def test_files_are_proved_again(self, name):
        certificate = pf.Certificate.load(folder() / f"{name}.toml")
        pf.check(certificate, ALL[name])
        assert (certificate.name, certificate.order) == (name, ALL[name].order)
        assert pf.Certificate.loads(certificate.dumps()) == certificate

    def test_methods_that_must_be_proved(self):
        values = {name: pf.proved(method) for name, method in ALL.items()}
        assert values == dict.fromkeys(ALL, "yes") | dict.fromkeys(PARTLY, "in part") | {
            "CG6a": "no"
        }
        assert set(CERTIFIED) == set(ALL) - {"CG6a"}

    @pytest.mark.parametrize("name", PROVED_HERE)
    def test_certify_equals_stored_certificates(self, name):
        assert pf.certify(name) == pf.certificate_of(ALL[name])

    def test_radii_are_at_the_last_places(self):
        for name in ("CG4", "CG4a", "CG5a"):
            assert pf.certificate_of(methods[name]).radius < Decimal("1e-33")

    def test_exact_zeros_are_fixed(self):
        assert {"a_9,1", "b_2"} < set(pf.certificate_of(methods["CG5a"]).fixed)
        assert {"a_2,1", "b_2"} < set(pf.certificate_of(methods["CG4"]).fixed)

    def test_cg6a_is_refused(self):
        with pytest.raises(pf.CertificationError, match="more than the last places") as caught:
            pf.certify("CG6a")
        actual = caught.value.quantities
        assert actual["residual"] > actual["allowed"] > 0

    @pytest.mark.parametrize("rows", [Rows.DIAGONAL, Rows.FULL])
    def test_implicit_methods(self, rows):
        method = search(order=3, stages=3, rows=rows)
        certificate = pf.certify(method)
        assert certificate.order == 3
        pf.check(certificate, method)

    def test_a_pair_is_proved_jointly(self):
        method = search(order=4, stages=6, embedded=True)
        certificate = pf.certify(method)
        assert (certificate.order, certificate.embedded_order) == (4, 3)
        assert len(certificate.fixed) == 21 + 6 - 13 - 5
        pf.check(certificate, method)


class TestFailures:
    @pytest.mark.parametrize(("name", "entry"), [("CG4a", "a_3,1"), ("CG5a", "a_5,2")])
    def test_a_change_of_1e_20_is_noticed(self, name, entry):
        changed = perturbed(methods[name], entry, "1e-20")
        with pytest.raises(pf.CertificationError, match="more than the last places"):
            pf.check(pf.certificate_of(methods[name]), changed)
        refuses(pf.CertificationError, "violated by much", pf.certify, changed)
        with pytest.raises(pf.CertificationError, match="more than the last places"):
            pf.certify(changed, methods[name].order)

    def test_a_fixed_coefficient_is_noticed_too(self):
        fixed = pf.certificate_of(methods["CG4a"]).fixed[0]
        changed = perturbed(methods["CG4a"], fixed, "-1e-20")
        with pytest.raises(pf.CertificationError, match="more than the last places"):
            pf.check(pf.certificate_of(methods["CG4a"]), changed)

    @pytest.mark.parametrize("name", ["CG3", "CG4a", "CG5a"])
    def test_wrong_orders(self, name):
        order = methods[name].order
        with pytest.raises(
            pf.CertificationError, match=f"the order is {order}, not {order + 1}: .*violated"
        ):
            pf.certify(name, order + 1)
        refuses(pf.CertificationError, "isn't the highest", pf.certify, name, order - 1)

    @pytest.mark.parametrize(("message", "name", "values"), [
        ("as many movable coefficients", "order", (3, 5)), ("no zero is", "bits", (60,)),
        ("between 53 and 16384", "bits", (10**9,)), ("it is for 'CG5a'", "name", ("CG5a",)),
        ("second weights must", "embedded_order", (3,)), ("a radius of 0", "radius", (Decimal(0),)),
        ("no zero is proved", "radius", (Decimal("1.1e-36"), Decimal("0.5"))),
        ("as many movable", "left_out", ((Condition(0, ((),)),),)),
        ("distinct independent ones", "left_out", ((Condition(0, ((), ())),),)),
        ("as many movable", "fixed", ((),)), ("no zero is", "fixed", (("a_2,1", "a_3,1"),)),
        ("distinct ones of", "fixed", (("a_4,2", "a_4,2"), ("a_2,1", "a_9,1"))),
    ])  # fmt: skip
    def test_tampered_certificates(self, message, name, values):
        for value in values:
            changed = replace(pf.certificate_of(methods["CG4a"]), **{name: value})
            refuses(pf.CertificationError, message, pf.check, changed, methods["CG4a"])

    def test_a_dependent_choice_of_movable_coefficients(self):
        honest = pf.certificate_of(methods["CG5a"])
        names = methods["CG5a"].layout.names
        zeros = ("a_9,1", "b_2")
        fixed = zeros + tuple(n for n in names if n.startswith("b_") and n not in zeros)[:7]
        with pytest.raises(pf.CertificationError, match="no zero is proved"):
            pf.check(replace(honest, fixed=fixed), methods["CG5a"])

    @pytest.mark.parametrize("name", ["CG3", "CG4a"])
    def test_tampered_bounds(self, name):
        honest = pf.certificate_of(methods[name])
        for changed in (
            replace(honest.beyond, bound=2 * honest.beyond.bound + 1),
            replace(honest.beyond, bound=Decimal(0)),
            replace(honest.beyond, word=((),)),
        ):
            with pytest.raises(pf.CertificationError, match=r"isn't violated|no independent"):
                pf.check(replace(honest, beyond=changed), methods[name])

    def test_a_pair_needs_both(self):
        pair, honest = methods["CG2(3)"], pf.certificate_of(methods["CG2(3)"])
        alone, higher = {"embedded_order": None, "embedded_beyond": None}, {"embedded_order": 3}
        for change, message in ((alone, "second weights must"), (higher, "embedded is violated")):
            refuses(pf.CertificationError, message, pf.check, replace(honest, **change), pair)

    def test_unexplained_dependent_conditions(self):
        with pytest.raises(pf.CertificationError, match="dependent") as caught:
            pf.certify("CG4c", complete=True)
        assert caught.value.quantities["conditions"] == 13
        assert caught.value.quantities["rank"] == 12

    def test_methods_without_order(self):
        with pytest.raises(pf.CertificationError, match="no order conditions"):
            pf.certify(Tableau([[]], ["0.5"], name="half"))


class TestDigits:
    @pytest.mark.parametrize("name", ["CG4c", "CG4a", "CG5a"])
    def test_residuals_at_100_digits(self, name):
        method = methods[name]
        a, b = cg.digits(method, 100)
        residuals = conditions.residuals(a, b, method.order, arithmetic="exact")
        assert max(map(abs, residuals)) < Fraction(1, 10**98)

    def test_rational_methods_and_pairs(self):
        assert cg.digits(methods["CG3"], 100)[1] == ["13/51", "-2/3", "24/17"]
        assert cg.digits(methods["CG2(3)"], 9, embedded=True)[1] == ["17/54", "19/54", "1/3"]
        method = search(order=4, stages=6, embedded=True)
        certificate = pf.certify(method)
        a, second = cg.digits(method, 60, certificate=certificate, embedded=True)
        residuals = conditions.residuals(a, second, 3, arithmetic="exact")
        assert max(map(abs, residuals)) < Fraction(1, 10**57)

    def test_errors(self):
        refuses(pf.CertificationError, "CG6a has no certificate", cg.digits, methods["CG6a"], 50)
        with pytest.raises(pf.CertificationError, match="isn't in the catalogue"):
            cg.digits(perturbed(methods["CG4a"], "a_3,1", "1e-20"), 50)
        with pytest.raises(pf.CertificationError, match="it is for 'CG4a', not for 'CG4b'"):
            cg.digits(methods["CG4b"], 50, certificate=pf.certificate_of(methods["CG4a"]))
        refuses(ValueError, "digits must", cg.digits, methods["CG4a"], 0)
        refuses(ValueError, "digits must", cg.digits, methods["CG4a"], 10**6)
        refuses(ValueError, "without second weights", cg.digits, methods["CG4a"], 50, embedded=True)


@pytest.mark.parametrize("digits", [1, 9, 17, 30])
def test_few_digits_are_the_rounded_many(digits):
    few, many = cg.digits(methods["CG4a"], digits)[1], cg.digits(methods["CG4a"], 60)[1]
    for short, long in zip(few, many, strict=True):
        assert abs(Fraction(short) / Fraction(long) - 1) < Fraction(1, 10 ** (digits - 1))


@pytest.mark.parametrize(("order", "error"), [
    (2.5, TypeError), ("2", TypeError), (True, TypeError), (0, ValueError), (10**30, ValueError)
])  # fmt: skip
def test_certify_rejects_bad_orders(order, error):
    refuses(error, "order must", pf.certify, "CG4a", order)


def test_dependent_conditions_are_below_a_bound():
    method = methods["CG5a"]
    certificate = certificate_of(method)
    left_out = certificate.left_out
    assert f"all but {len(left_out)} of the independent conditions" in str(certificate)
    assert "the residuals of the rest are below 1e-300" in str(certificate)
    assert Certificate.loads(certificate.dumps()) == certificate
    for bound in ("1e-20", "0", "-1e-50"):
        with pytest.raises(CertificationError, match=r"must be at most 1e-40|bound must be"):
            replace(certificate, bound=Decimal(bound))
    for wrong in ((*left_out, Condition(0, ())), (*left_out, left_out[0]), left_out[1:]):
        message = "distinct independent ones" if len(wrong) > len(left_out) else "as many movable"
        refuses(CertificationError, message, check, replace(certificate, left_out=wrong), method)


@pytest.mark.parametrize("name", ["CG4", "CG5a", "DICG4", "CF5r"])
def test_bounds_are_tight_and_limit_the_digits(name):
    """Where residuals are quadratic in the distance from a solution, they are no smaller."""
    method = methods[name]
    certificate = certify(method)
    assert certificate == certificate_of(method)
    assert not certificate.complete
    check(certificate, method)
    bound = certificate.bound
    assert (bound == Decimal("1e-300")) == (name not in ("CG4", "CF5r"))
    if bound > Decimal("1e-300"):
        with pytest.raises(CertificationError, match="small is not proved"):
            check(replace(certificate, bound=bound / 1000), method)
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
    wrong = replace(
        certificate, left_out=(Condition(0, parse("[[[[[]]]]]")),), bound=Decimal("1e-41"),
        fixed=(*certificate.fixed, movable[0]),
    )  # fmt: skip
    refuses(CertificationError, "that conditions are small is not proved", check, wrong, method)


def test_where_the_zero_is():
    """Balls around the zero of a wide box lie in those of a narrow one."""
    method = methods["CG4a"]
    certificate = certify(method)
    packed = fitting(certificate, method)
    system, movable = packed.system(), packed.movable(certificate)
    with working_precision(1000):
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
    with working_precision(200):
        test = krawczyk(system, packed.balls(), movable, arb("1e-35"))
        with pytest.raises(CertificationError, match="100 places aren't proved"):
            enclose_zero(system, packed.balls(), movable, test, 100)


@pytest.mark.parametrize("name", ["CG3", "CF5c"])
def test_complete_proofs(name):
    assert certify(name, complete=True).complete
