"""Each known mistake is recognised; methods without mistakes have none."""

import json
from fractions import Fraction

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.catalogue import dumps
from cg.construction.diagnosis import diagnose_file, draw_points, draw_tree
from cg.construction.diagnosis.correction import corrections
from cg.construction.methods.coefficients import Coefficient
from cg.construction.trees.ordered import OrderedTree
from cg.problems.convergence import observed_order, slopes
from cg.support.quads import to_decimal

CG4A = cg.methods["CG4a"]
SLIP = "-1.1092979392113565"
CLASSICAL = cg.Tableau(
    [[], ["1/2"], [0, "1/2"], [0, 0, 1]], ["1/6", "1/3", "1/3", "1/6"], name="RK4"
)


def kinds(method, **options):
    return {finding.kind for finding in cg.diagnose(method, **options).mistakes}


def texts(method):
    rows = [[entry.text for entry in row[:i]] for i, row in enumerate(method.entries)]
    return rows, [weight.text for weight in method.weights]


def cut(text, places):
    """Return a decimal text cut after a number of places."""
    whole, _, part = text.partition(".")
    return f"{whole}.{part[:places]}" if part else text


def changed(method, k, value):
    coefficients = list(method.coefficients)
    coefficients[k] = Coefficient.read(value)
    return method.with_coefficients(coefficients)


@pytest.mark.parametrize(
    "name", ["CG2(3)", "CG3", "CG4", "CG4(3)", "CG5a", "CF3", "CF4b", "CF5(4)", "DICG4"]
)
def test_catalogue_methods_have_no_mistake(name):
    diagnosis = cg.diagnose(cg.methods[name])
    assert diagnosis.mistakes == ()
    assert diagnosis.findings == ()
    assert diagnosis.order == diagnosis.flat_order == cg.methods[name].order
    assert diagnosis.embedded_order == cg.methods[name].embedded_order
    assert diagnosis.failing.order == diagnosis.order + 1
    assert "no known mistake recognised" in str(diagnosis)


@pytest.mark.parametrize("name", ["CG4a", "CG3", "CG5a"])
def test_reversed_rows(name):
    a, b = texts(cg.methods[name])
    both = cg.diagnose(cg.Tableau([row[::-1] for row in a], b[::-1]))
    assert [f.kind for f in both.mistakes] == ["reversed"]
    assert f"they give {name}, of order" in both.mistakes[0].message
    assert both.order < cg.methods[name].order
    (one,) = cg.diagnose(cg.Tableau([row[::-1] for row in a], b)).mistakes
    assert (one.kind, one.message[:13]) == ("reversed", "the rows of a")


@pytest.mark.parametrize("name", ["CF4", "CF5a"])
def test_reversed_flows(name):
    method = cg.methods[name]
    weights = method.point_coefficients
    points, ends = [], {-1: -1}
    for end in sorted({*method.stage_points, method.result}):
        last = -1
        for m in reversed(method.tree.path(end)):
            points.append((last, weights[m]))
            last = len(points) - 1
        ends[end] = last
    planted = cg.CommutatorFree(points, [ends[m] for m in method.stage_points], ends[method.result])
    diagnosis = cg.diagnose(planted)
    assert "reversed" in {f.kind for f in diagnosis.mistakes}
    assert diagnosis.order < method.order
    assert any(f"of order {method.order}" in f.message for f in diagnosis.mistakes)


def test_misprint_of_cg4a():
    planted = changed(CG4A, CG4A.layout.names.index("a_5,4"), SLIP)
    diagnosis = cg.diagnose(planted)
    (finding,) = diagnosis.mistakes
    assert finding.message.startswith("it differs from CG4a in a_5,4 only: ")
    assert diagnosis.order < 4
    double = changed(planted, 0, CG4A.a[1, 0])
    assert kinds(double) == {"changed"}
    # from doubles it is no other method
    rounded = CG4A.with_coefficients([Coefficient.read(float(k.value)) for k in CG4A.coefficients])
    assert kinds(rounded) == set()


@pytest.mark.parametrize(("name", "place"), [("CG4a", "b_3"), ("CG5a", "a_7,2"), ("CF4", "w_4,3")])
def test_changed_coefficient(name, place):
    method = cg.methods[name]
    k = method.layout.names.index(place)
    planted = changed(method, k, -method.coefficients[k].value)
    (finding,) = cg.diagnose(planted).mistakes
    assert finding.kind == "changed"
    assert finding.message.startswith(f"it differs from {name} in {place} only: ")


def one_of_each_kind():
    kinds = (cg.Tableau, cg.CommutatorFree, cg.MuntheKaas)
    exact = [m for m in cg.methods.values() if isinstance(m, kinds) and not m.approximate]
    # collocation methods allow no change
    exact = [m for m in exact if m.order <= 6 and m.name != "RadauIIA5"]
    return [m for m in exact if m.order < 6 or m.layout.size < 80]


@pytest.mark.parametrize("method", one_of_each_kind(), ids=lambda method: method.name)
def test_misprints_of_unknown_methods(method):
    random = np.random.default_rng(sum(map(ord, method.name)))
    assert corrections(method) == []
    for _ in range(2):
        k = int(random.integers(method.layout.size))
        right = method.coefficients[k]
        error = Fraction(random.choice([-1, 1]) * 10 ** random.uniform(-8, -3))
        wrong = changed(method, k, to_decimal(right.value + error, 25))
        only, *others = corrections(wrong)
        assert not others or only.conditions == 1
        assert only.name == method.layout.names[k]
        assert abs(only.value.value - right.value) <= max(4 * right.unit, Fraction(1, 10**32))
        corrected = changed(wrong, k, only.value)
        assert (corrected.exact_order, corrected.embedded_order) == (
            method.exact_order,
            method.embedded_order,
        )


def test_misprint_outside_the_catalogue_is_described():
    # Ralston's method of order two, and a method of order three that was just found
    (note,) = cg.diagnose(cg.Tableau([[], ["0.666669"]], ["1/4", "3/4"])).findings
    assert (note.kind, note.mistake) == ("close", False)
    assert note.message.endswith("the order be 2, if only a_2,1 = 0.666669 were 2/3")
    method = cg.search(3, 4, seed=5).methods[0]
    k = method.layout.names.index("a_4,2")
    wrong = changed(method, k, to_decimal(method.coefficients[k].value + Fraction(3, 10**6), 36))
    (finding,) = cg.diagnose(wrong).mistakes
    assert finding.kind == "misprint"
    assert f" were {method.coefficients[k].text[:30]}" in finding.message


@pytest.mark.parametrize("digit", [17, 20, 30, 33])
def test_wrong_digits_beyond_double_precision(digit):
    text = CG4A.coefficients[9].text
    planted = changed(CG4A, 9, CG4A.coefficients[9].value + Fraction(1, 10**digit))
    planted = changed(planted, 9, to_decimal(planted.coefficients[9].value, 36))
    (finding,) = cg.diagnose(planted).mistakes
    assert finding.kind == "changed"
    assert f"; {text} there" in finding.message or f", {text} there" in finding.message


def test_catalogue_coefficients_are_recognised():
    a, b = texts(CG4A)
    diagnosis = cg.diagnose(cg.Tableau(a, b, name="mine"))
    assert [f.message for f in diagnosis.findings] == ["its coefficients are those of CG4a"]
    assert diagnosis.mistakes == ()


@pytest.mark.parametrize("places", [5, 7, 9])
def test_truncated_digits(places):
    a, b = texts(CG4A)
    planted = cg.Tableau([[cut(x, places) for x in row] for row in a], [cut(x, places) for x in b])
    (finding,) = cg.diagnose(planted).mistakes
    assert finding.kind == "digits"
    residual = planted.largest_residual(4)
    assert 0.01 < residual * 10**places < 10
    assert f"off by {residual:.1g}" in finding.message


def test_truncated_doubles_and_single_precision():
    a, b = CG4A.a, CG4A.b
    planted = cg.Tableau(np.round(a, 7).tolist(), np.round(b, 7).tolist())
    (finding,) = cg.diagnose(planted).mistakes
    assert (finding.kind, "7 places" in finding.message) == ("digits", True)
    planted = cg.Tableau(a.astype(np.float32).tolist(), b.astype(np.float32).tolist())
    (finding,) = cg.diagnose(planted).mistakes
    assert (finding.kind, "single precision" in finding.message) == ("digits", True)
    assert kinds(cg.Tableau(a.tolist(), b.tolist())) == set()


def test_short_exact_decimals_are_no_mistake():
    assert kinds(cg.Tableau([[], ["0.5"]], ["0", "1"])) == set()
    assert kinds(cg.Tableau([[], [0.5]], [0.0, 1.0])) == set()


def test_transposed_a():
    a, b = cg.methods["CG3"].exact
    diagnosis = cg.diagnose(cg.Tableau(list(zip(*a, strict=True)), b))
    (finding,) = diagnosis.mistakes
    assert finding.kind == "transposed"
    assert "the transpose is CG3, explicit, of order 3" in finding.message
    assert diagnosis.order < 3
    assert kinds("DICG4") == set()


@pytest.mark.parametrize(
    ("tableau", "on_manifolds", "flat"), [(CLASSICAL, 2, 4), (cg.methods["RKMK5(4)"].tableau, 2, 5)]
)
def test_unlifted_classical_method(tableau, on_manifolds, flat):
    diagnosis = cg.diagnose(tableau)
    assert (diagnosis.order, diagnosis.flat_order) == (on_manifolds, flat)
    assert [f.kind for f in diagnosis.mistakes] == ["flat"]
    assert cg.diagnose(cg.MuntheKaas(tableau)).mistakes == ()


def test_row_sums_differ_from_c():
    c = [0, "0.8177227988124852", "0.3859740639032449", "0.3242290522866937", "0.8768903263420429"]
    assert kinds(CG4A, c=c) == set()
    c[2] = "0.3859740639132449"
    (finding,) = cg.diagnose(CG4A, c=c).mistakes
    assert finding.kind == "abscissae"
    assert "row 3 of a sums to 0.385974063903244" in finding.message
    assert finding.message.endswith("not to c_3 = 0.3859740639132449: off by -1e-11")
    refuses(ValueError, "c must", cg.diagnose, CG4A, c=[0])
    refuses(ValueError, "c must", cg.diagnose, CG4A, c="0")


@pytest.mark.parametrize("text", ["{:.17g}", "{!r}", "{:.17f}", "{:.16f}", "{:.15g}"])
@pytest.mark.parametrize("name", ["CG3", "CG4a", "CG5a"])
def test_printed_doubles(name, text):
    """A double has 15 to 17 digits, of which the last may be off by several units."""
    method = cg.methods[name]
    c = [text.format(float(sum(row))) for row in method.exact[0]]
    assert kinds(method, c=c) == set()
    a = [[text.format(float(x)) for x in row[:i]] for i, row in enumerate(method.exact[0])]
    tableau = cg.Tableau(a, [text.format(float(x)) for x in method.exact[1]])
    found = cg.diagnose(tableau, c=c)
    assert (found.order, found.mistakes) == (method.order, ())


def test_equal_second_weights(tmp_path):
    a, b = texts(CG4A)
    second = [b[0][:-3] + "999", *b[1:]]
    assert kinds(cg.Tableau(a, b, b_embedded=second)) == {"equal weights"}
    file = tmp_path / "mine.toml"
    lines = [f"a = {json.dumps(a)}", f"b = {json.dumps(b)}", f"b_embedded = {json.dumps(b)}"]
    file.write_text("\n".join(lines))
    diagnosis = diagnose_file(file)
    assert (diagnosis.order, diagnosis.method.name) == (4, "mine")
    assert [f.kind for f in diagnosis.mistakes] == ["equal weights"]


def test_files_with_abscissae(tmp_path):
    file = tmp_path / "method.toml"
    text = dumps(cg.methods["CG3"])
    file.write_text(f'{text}\nc = ["0", "3/4", "17/24"]\n')
    assert diagnose_file(file).mistakes == ()
    file.write_text(f'{text}\nc = ["0", "3/4", "17/25"]\n')
    assert [f.kind for f in diagnose_file(file).mistakes] == ["abscissae"]
    file.write_text(json.dumps({"a": [[], ["1/2"]], "b": [0, 1], "c": [0, 0.5]}))
    assert (diagnose_file(file).order, diagnose_file(file).mistakes) == (2, ())
    file.write_text(dumps(cg.methods["CF4(3)"]))
    assert diagnose_file(file).order == 4
    file.write_text(f'{text}\nd = ["0"]\n')
    refuses(cg.TableauError, r"method.toml: the entry has unknown keys: d", diagnose_file, file)
    file.write_text("a = [[]]\nb = [[]]\nb_embedded = [[]]\n")
    refuses(cg.TableauError, r"method.toml: b_1: ", diagnose_file, file)


def test_munthe_kaas():
    (finding,) = cg.diagnose(changed(cg.methods["RKMK5(4)"], 3, "1/7")).mistakes
    assert finding.message.startswith("it differs from RKMK5(4) in a_4,1 only: 1/7 here, ")
    diagnosis = cg.diagnose("RKMK4")
    assert (diagnosis.order, diagnosis.mistakes, diagnosis.failing.order) == (4, (), 5)


def test_first_violated_condition():
    failing = cg.diagnose(cg.methods["CG2"]).failing
    a, b = cg.methods["CG2"].exact
    exact = cg.conditions.residuals(a, b, 3, independent=True, arithmetic="exact")
    assert failing.order == 3
    assert failing.residual == pytest.approx(float(next(r for r in exact[2:] if r != 0)), rel=1e-14)
    assert failing.right_side == Fraction(1, failing.tree.density)
    assert failing.failing == sum(r != 0 for r in exact[2:])
    assert failing.of == 3
    assert json.loads(json.dumps(cg.diagnose("CG2").as_dict()))["first_failing"]["tree"] == str(
        failing.tree
    )


def test_implicit_and_approximate_methods():
    assert cg.diagnose("ImplicitMidpoint").order == 2
    diagnosis = cg.diagnose("CG6a")
    assert diagnosis.mistakes == ()
    assert "nominal order: 6" in str(diagnosis)
    assert (diagnosis.order, diagnosis.flat_order) == (1, 1)  # [[[]]] has one sequence of flows


@pytest.mark.parametrize("name", ["CG4a", "CG4b", "CG5b"])
def test_rounded_numbers_given_as_exact_fractions(name):
    method = cg.methods[name]
    assert kinds(cg.Tableau(*method.exact)) == {"fractions"}
    doubles = [[[Fraction(x) for x in row] for row in method.a], [Fraction(x) for x in method.b]]
    (mistake,) = cg.diagnose(cg.Tableau(*doubles)).mistakes
    assert f"order {method.order}" in mistake.message
    assert kinds(cg.Tableau(method.a, method.b)) == set()


def test_drawings():
    assert draw_tree(OrderedTree.parse("[[[]][]]")) == "●\n├── ●\n│   └── ●\n└── ●"
    assert draw_points(cg.methods["LieEuler"]) == "start: stage 1\n└── point 1: 1 F1; result"
    pair = draw_points(cg.methods["CF4(3)"], digits=3)
    assert pair.count("second result") == 1
    assert pair.count("point") == len(cg.methods["CF4(3)"].points)
    refuses(TypeError, "tree must", draw_tree, "[]")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("small", ["1e-300", "1e-310", "1e-320", "1e-400", "1e-9999"])
@pytest.mark.parametrize("other", ["1", "1.000000000000000000000000000000001"])
def test_tiny_entries_within_their_last_place(small, other):
    diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], [small, other]))
    assert diagnosis.order == 2
    assert diagnosis.failing.order == 3


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("exponent", [100, 200, 300, 400, 4000])
def test_tiny_rational_errors_count(exponent):
    small = Fraction(1, 10**exponent)
    diagnosis = cg.diagnose(cg.Tableau([[], ["1/2"]], [small, 1 - 2 * small]))
    assert (diagnosis.order, diagnosis.failing.order) == (0, 1)
    assert diagnosis.failing.residual == -float(small)
    assert diagnosis.failing.failing == diagnosis.failing.of == 1
    size = f"-1e-{exponent}" if exponent < 330 else "less than a double can tell"
    assert f"off by {size}" in str(diagnosis)
    second = cg.diagnose(cg.Tableau([[], [Fraction(1, 2) + small]], [0, 1]))
    assert (second.order, second.failing.order, second.failing.failing) == (1, 2, 1)


def test_slope_of_exact_powers():
    h = np.array([0.05, 0.4, 0.1, 0.2])
    assert observed_order(h, 3.0 * h**4) == pytest.approx(4.0)
    np.testing.assert_allclose(slopes(h, h**2.5), 2.5)


def test_asymptotic_range_leaves_out_coarse_steps_and_rounding():
    h = np.array([1.0, 0.5, 0.25, 0.125, 0.0625])
    errors = np.array([3.0, 0.25, 0.0625, 0.015625, 1e-16])
    assert observed_order(h, errors, floor=1e-15, h_range=(0.0, 0.5)) == pytest.approx(2.0)
    assert observed_order(h, errors, h_range=(0.1, 0.5)) == pytest.approx(2.0)
    assert observed_order(h[:4], errors[:4]) > 2.2


@pytest.mark.parametrize(("h", "errors", "changes", "message"), [
    ([0.1, 0.2], [1.0], {}, "must be vectors of one length"),
    ([[0.1, 0.2]], [[1.0, 2.0]], {}, "must be vectors of one length"),
    ([0.1, 0.2], [1.0, np.nan], {}, "errors must be positive and finite"),
    ([0.1, 0.2], [1.0, np.inf], {}, "errors must be positive and finite"),
    ([0.1, -0.2], [1.0, 2.0], {"h_range": (-1.0, 1.0)}, "h must be positive and finite"),
    ([0.1, 0.1], [1.0, 2.0], {}, "h must be distinct"),
    ([0.1, 0.2], [1e-17, 1.0], {"floor": 1e-15}, "errors must leave two points"),
    ([0.1, 0.2], [1.0, 2.0], {"h_range": (0.15, 1.0)}, "errors must leave two points"),
])  # fmt: skip
def test_bad_errors_are_refused(h, errors, changes, message):
    refuses(ValueError, message, observed_order, h, errors, **changes)
