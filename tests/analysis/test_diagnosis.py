"""The failing condition and the wrong coefficient are named; methods without mistakes have none."""

import json
from fractions import Fraction

import numpy as np
import pytest
from coefficients import CLASSICAL, FEHLBERG_A, FEHLBERG_B
from refusals import refuses
from slow_cases import slow

import cg
from cg.construction.catalogue import dumps
from cg.construction.diagnosis import diagnose_file
from cg.construction.methods.coefficients import Coefficient
from cg.support.quads import to_decimal

CG4A = cg.methods["CG4a"]


def changed(method, k, value):
    coefficients = list(method.coefficients)
    coefficients[k] = Coefficient.read(value)
    return method.with_coefficients(coefficients)


# the other methods of orders four to six are like these
LIKE_OTHERS = {"CG5(4)", "CG5a", "CF5a", "CF5r", "DP5(4)", "RKMK5(4)", "RadauIIA5", "DICG6"}


def one_of_each_kind():
    kinds = (cg.Tableau, cg.CommutatorFree, cg.MuntheKaas)
    exact = [m for m in cg.methods.values() if isinstance(m, kinds) and not m.approximate]
    quick = [m for m in exact if m.order < 4 or m.name in LIKE_OTHERS]
    return [*quick, *slow(*(m for m in exact if m.order < 7 and m not in quick))]


@pytest.mark.parametrize("method", one_of_each_kind(), ids=lambda method: method.name)
def test_misprints_in_methods_of_the_catalogue(method):
    diagnosis = cg.diagnose(method)
    assert (diagnosis.mistakes, diagnosis.corrections) == ((), ())
    assert diagnosis.order == diagnosis.flat_order == method.exact_order
    assert diagnosis.failing.order == diagnosis.order + 1
    assert str(diagnosis).endswith("no mistake recognised")
    if method.name == "RadauIIA5":  # as it is solved by Newton's method, it allows no change
        return
    random = np.random.default_rng(sum(map(ord, method.name)))
    # a large change for the sake of one condition isn't taken for a correction
    for largest in (-6, -3, 0) if method.order > 2 else (-6, -3):
        k = int(random.integers(method.layout.size))
        right = method.coefficients[k]
        error = Fraction(random.choice([-1, 1]) * 10 ** random.uniform(largest - 2, largest))
        wrong = changed(method, k, to_decimal(right.value + error, 25))
        diagnosis = cg.diagnose(wrong)
        mistake, (only, *others) = diagnosis.mistakes[0], diagnosis.corrections
        assert not others or only.conditions == 1
        assert only.name == method.layout.names[k]
        assert f"{only.name} = {only.given} were {only.value}" in mistake
        assert abs(Fraction(only.value) - right.value) <= max(4 * right.unit, Fraction(1, 10**32))
        corrected = changed(wrong, k, only.value)
        assert corrected.exact_order == method.exact_order
        assert corrected.embedded_order == method.embedded_order


@pytest.mark.parametrize("kind", [cg.Tableau, lambda *a, **b: cg.MuntheKaas(cg.Tableau(*a, **b))])
@pytest.mark.parametrize("second", [None, 0, 1])
def test_misprint_in_fehlbergs_tableau(kind, second):
    """Only the row of the last stage is wrong, on which the weights of order four don't depend."""
    a = [*FEHLBERG_A[:-1], [*FEHLBERG_A[-1][:2], "-3554/2565", *FEHLBERG_A[-1][3:]]]
    pair = {} if second is None else {"b_embedded": FEHLBERG_B[second]}
    diagnosis = cg.diagnose(kind(a, FEHLBERG_B[second != 1], **pair))
    (one,) = diagnosis.corrections
    assert (one.name, one.given, one.value) == ("a_6,3", "-3554/2565", "-3544/2565")
    assert (one.order, one.flat, one.embedded) == (5, True, second == 1)
    assert diagnosis.flat_order == (4 if second == 1 else 1)
    where = "order of the second result" if second == 1 else "order"
    assert f"the {where} be 5 where flows commute, if only a_6,3 = " in diagnosis.mistakes[0]
    right = cg.diagnose(kind(FEHLBERG_A, FEHLBERG_B[second != 1], **pair))
    assert right.corrections == ()


def test_single_condition():
    (one,) = cg.diagnose(cg.Tableau([[], ["0.666669"]], ["1/4", "3/4"])).corrections
    assert (one.name, one.value, one.order, one.conditions) == ("a_2,1", "2/3", 2, 1)
    (one,) = cg.diagnose(cg.Tableau([[], ["0.676"]], ["0.2499000000", "0.7501000000"])).corrections
    assert one.value == "0.66657778963"  # 2/3 is near by chance
    # many coefficients solve one condition, so that large changes are no correction of a misprint
    assert cg.diagnose(cg.Tableau([[], ["1/2"]], ["1/4", "3/4"])).mistakes == ()


@pytest.mark.parametrize("digit", [17, 20, 25])
def test_wrong_digits_beyond_double_precision(digit):
    right = CG4A.coefficients[9]
    planted = changed(CG4A, 9, to_decimal(right.value + Fraction(1, 10**digit), 36))
    (one,) = cg.diagnose(planted).corrections
    assert one.name == CG4A.layout.names[9]
    assert abs(Fraction(one.value) - right.value) <= 4 * right.unit


def test_too_few_digits():
    a, b = CG4A.exact
    cut = [[f"{float(x):.7f}" for x in row] for row in a], [f"{float(x):.7f}" for x in b]
    single = CG4A.a.astype(np.float32).tolist(), CG4A.b.astype(np.float32).tolist()
    for tableau in (cg.Tableau(*case) for case in (cut, single, CG4A.exact)):
        (mistake,) = cg.diagnose(tableau).mistakes
        residual = tableau.max_residual(4)
        assert f"conditions through order 4 hold up to {residual:.1g} only" in mistake


@pytest.mark.parametrize("text", ["{:.17g}", "{!r}", "{:.17f}", "{:.16f}", "{:.15g}"])
@pytest.mark.parametrize("name", ["CG3", "CG4a", "CG5a"])
def test_printed_doubles(name, text):
    """A double has 15 to 17 digits, of which the last may be off by several units."""
    method = cg.methods[name]
    c = [text.format(float(sum(row))) for row in method.exact[0]]
    a = [[text.format(float(x)) for x in row[:i]] for i, row in enumerate(method.exact[0])]
    tableau = cg.Tableau(a, [text.format(float(x)) for x in method.exact[1]])
    found = cg.diagnose(tableau, c=c)
    assert (found.order, found.mistakes) == (method.order, ())


@pytest.mark.parametrize(("tableau", "flat"), [(CLASSICAL, 4), (cg.methods["RKMK5(4)"].tableau, 5)])
def test_unlifted_classical_method(tableau, flat):
    diagnosis = cg.diagnose(tableau)
    assert (diagnosis.order, diagnosis.flat_order) == (2, flat)
    (mistake,) = diagnosis.mistakes
    assert mistake.startswith(f"it is a classical method: of order {flat} where flows commute")
    assert cg.diagnose(cg.MuntheKaas(tableau)).mistakes == ()


def test_row_sums_and_second_weights():
    c = ["0", "3/4", "17/25"]
    (mistake,) = cg.diagnose("CG3", c=c).mistakes
    assert mistake == "row 3 of a sums to 17/24, not to c_3 = 17/25: off by 0.0283"
    refuses(ValueError, "c must", cg.diagnose, "CG3", c=[0])
    a, b = CG4A.exact
    (mistake, _) = cg.diagnose(
        cg.Tableau(a, b, b_embedded=[b[0] + Fraction(1, 10**33), *b[1:]])
    ).mistakes
    assert mistake.startswith("the second weights equal the first up to 1e-33")


def test_files(tmp_path):
    file = tmp_path / "method.toml"
    file.write_text(f'{dumps(cg.methods["CG3"])}\nc = ["0", "3/4", "17/25"]\n')
    assert "row 3 of a sums to 17/24" in diagnose_file(file).mistakes[0]
    file.write_text(json.dumps({"a": [[], ["1/2"]], "b": [0, 1], "c": [0, 0.5]}))
    assert (diagnose_file(file).order, diagnose_file(file).method.name) == (2, "method")
    file.write_text("a = [[]]\nb = [[]]\n")
    refuses(cg.TableauError, r"method.toml: b_1: ", diagnose_file, file)


def test_first_violated_condition():
    diagnosis = cg.diagnose("CG2")
    failing = diagnosis.failing
    exact = cg.conditions.residuals(cg.methods["CG2"], 3, independent=True, arithmetic="exact")
    assert failing.order == 3
    assert failing.residual == float(next(r for r in exact if r != 0))
    assert failing.right_side == Fraction(1, failing.tree.density)
    data = json.loads(json.dumps(diagnosis.as_dict()))
    assert data["first_failing"]["tree"] == str(failing.tree)


def test_approximate_method():
    diagnosis = cg.diagnose("CG6a")
    assert diagnosis.mistakes == ()
    assert "order 6 (nominal)" in str(diagnosis)
    assert (diagnosis.order, diagnosis.flat_order) == (1, 1)  # [[[]]] has one sequence of flows


@pytest.mark.parametrize("small", ["1e-300", "1e-310", "1e-320", "1e-400", "1e-9999"])
@pytest.mark.parametrize("other", ["1", "1.000000000000000000000000000000001"])
def test_tiny_entries_within_their_last_place(small, other):
    diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], [small, other]))
    assert (diagnosis.order, diagnosis.failing.order) == (2, 3)


@pytest.mark.parametrize("exponent", [100, 300, 400, 4000])
def test_tiny_rational_errors_count(exponent):
    small = Fraction(1, 10**exponent)
    diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], [small, 1 - 2 * small]))
    assert (diagnosis.order, diagnosis.failing.order) == (0, 1)
    assert diagnosis.failing.residual == -float(small)
    size = f"-1e-{exponent}" if exponent < 330 else "less than a double can tell"
    assert f"off by {size}" in str(diagnosis)
    second = cg.diagnose(cg.Tableau([[], [Fraction(1, 2) + small]], [0, 1]))
    assert (second.order, second.failing.order) == (1, 2)


@pytest.mark.parametrize("kind", [cg.Tableau, lambda *rows: cg.MuntheKaas(cg.Tableau(*rows))])
@pytest.mark.parametrize("huge", ["1e160", "1e308"])
def test_residuals_beyond_doubles_are_violated(kind, huge):
    diagnosis = cg.diagnose(kind([[], [huge]], [0, 1]))
    assert (diagnosis.order, diagnosis.failing.residual) == (1, float(huge))
