"""Functions that search, prove and make methods reject bad input before they compute."""

import numpy as np
import pytest

import cg
from cg import conditions
from cg.catalogue import dumps, load, loads, save
from cg.conditions import (
    Rows,
    check_rows,
    count,
    count_classical,
    residuals,
    residuals_exact,
    unknowns,
)
from cg.construction import (
    Goals,
    correct,
    eliminate_stage,
    fewer_exponentials,
    optimise,
    pack_method,
    to_method,
)
from cg.construction.solvers.system import ConditionSystem
from cg.method.packed import make_method
from cg.problems import FreeRigidBody
from cg.proofs import certificate_of
from cg.proofs import check as prove
from cg.structure.layout import Layout
from cg.support.quads import decode, encode, from_float, to_decimal, to_float
from cg.trees.ordered import forest

HUGE = 10**400
MASKED = np.ma.masked_array([[0.0, 0.0], [1.0, 0.0]], mask=[[0, 0], [1, 0]])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"width": True}, ValueError, "width must be a finite number, not negative, got True"),
        ({"width": HUGE}, ValueError, "width must be a finite number, not negative, got 1000"),
        ({"width": 1e301}, ValueError, "width must be at most 1e\\+300, got 1e\\+301"),
        ({"refine_below": False}, ValueError, "refine_below must be a finite number"),
        ({"refine_below": HUGE}, ValueError, "refine_below must be a finite number"),
        ({"rows": True}, ValueError, "rows must be one of explicit, diagonal, full, got True"),
        ({"rows": 1.0}, ValueError, "rows must be one of explicit, diagonal, full, got 1.0"),
        ({"force": "no"}, TypeError, "force must be True or False, got 'no'"),
        ({"force": 1}, TypeError, "force must be True or False, got 1"),
        ({"stages": 1001}, ValueError, "stages must be at most 1000, got 1001"),
        ({"stages": 10**9}, ValueError, "stages must be at most 1000, got 1000000000"),
    ],
)
def test_search_rejects(changes, error, message):
    with pytest.raises(error, match=message):
        cg.search(**{"order": 2, "stages": 2, "starts": 1, "seed": 0} | changes)


def test_search_accepts_numpy_numbers():
    found = cg.search(2, np.int64(2), 1, 0, width=np.float32(0.5), rows=np.int64(0))
    assert found.settings == cg.search(2, 2, 1, 0, width=0.5).settings


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"width": True}, ValueError, "width must be a finite positive number, got True"),
        ({"width": 1e308}, ValueError, "width must be at most 1e\\+300, got 1e\\+308"),
        ({"width": HUGE}, ValueError, "width must be a finite positive number, got 1000"),
        ({"largest": True}, ValueError, "largest must be a finite positive number, got True"),
        ({"largest": HUGE}, ValueError, "largest must be a finite positive number, got 1000"),
        ({"full_rank": "no"}, TypeError, "full_rank must be True or False, got 'no'"),
        ({"force": None}, TypeError, "force must be True or False, got None"),
        ({"stages": 10**7}, ValueError, "stages must be at most 1000, got 10000000"),
        ({"first_stages": 10**6}, ValueError, "first_stages must be at most 1000, got 1000000"),
    ],
)
def test_construct_rejects(changes, error, message):
    with pytest.raises(error, match=message):
        cg.construct(**{"order": 3, "stages": 3, "seed": 0, "tries": 1} | changes)


@pytest.mark.parametrize("name", [[1], {}, np.array([1]), slice(1)])
def test_method_names_must_be_strings(name):
    with pytest.raises(TypeError, match="the name of a method must be a str, got"):
        cg.methods[name]
    assert name not in cg.methods
    assert None not in cg.methods
    assert cg.methods.get(1) is None


def test_certify_rejects_unknown_names():
    with pytest.raises(ValueError, match=r"got 'CG9z'.* CG4a, "):
        cg.certify("CG9z")


@pytest.mark.parametrize(
    "function",
    [
        count,
        count_classical,
        conditions.condition_trees,
        conditions.table_rows,
        lambda order: residuals([[0]], [1], order),
        lambda order: residuals_exact([[0]], [1], order),
        cg.methods["CG3"].largest_residual,
    ],
)
def test_orders_must_be_integers(function):
    function(1)  # the cached result for 1 must not serve True
    with pytest.raises(TypeError, match="order must be an integer, got True"):
        function(True)
    with pytest.raises(TypeError, match=r"order must be an integer, got 2\.5"):
        function(2.5)


@pytest.mark.parametrize(
    "function",
    [
        count,
        lambda order: residuals_exact([[0]], [1], order),
        cg.methods["CG3"].largest_residual,
    ],
)
def test_rejects_orders_beyond_the_tables(function):
    with pytest.raises(ValueError, match="order must be at most 13, got 99"):
        function(99)


def test_count_classical_rejects_high_orders():
    with pytest.raises(ValueError, match="order must be at most 2000, got 2001"):
        count_classical(2001)


def test_stages_must_be_integers():
    assert unknowns(10**9, "full") == 10**18 + 10**9
    for rows in Rows:
        assert unknowns(7, rows) == sum(Layout.tableau(7, rows).lengths)
    for stages in (True, 1.0, "1"):
        with pytest.raises(TypeError, match="stages must be an integer, got"):
            unknowns(stages)
        with pytest.raises(TypeError, match="stages must be an integer, got"):
            Layout.tableau(stages)
    assert check_rows("full") is check_rows(2) is Rows.FULL


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (MASKED, [0, 1], "a must be an array of real numbers, got masked"),
        ([[HUGE]], [1], "a must be an array of real numbers"),
        ([[0]], [HUGE], "b must be an array of real numbers"),
    ],
)
def test_residuals_reject(a, b, message):
    for function in (residuals, conditions.jacobian, conditions.weights):
        with pytest.raises(ValueError, match=message):
            function(a, b, 2)
    with pytest.raises(ValueError, match=message):
        conditions.pack(a, b)


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (MASKED, [0, 1], "row 2 of a must hold finite real numbers, got masked"),
        ([[0]], [np.inf], "b must hold finite real numbers, got inf"),
        ([[1j]], [1], "row 1 of a must hold finite real numbers, got 1j"),
        ([[0]], ["x"], "b must hold finite real numbers, got 'x'"),
        ([["1/0"]], [1], "row 1 of a must hold finite real numbers, got '1/0'"),
        ([[0]], 1, "b must be a sequence of numbers, got 1"),
        (0, [1], "a must be a sequence of rows, got 0"),
        ("ab", [1, 2], "a must be a sequence of rows, got 'ab'"),
    ],
)
def test_exact_residuals_reject(a, b, message):
    with pytest.raises(ValueError, match=message):
        residuals_exact(a, b, 2)


def test_exact_residuals_accept_single_precision():
    exact = residuals_exact(np.float32([[0, 0], [0.5, 0]]), np.float32([0, 1]), 2)
    assert exact == (0, 0, 0)


@pytest.mark.parametrize("b", [{0, 1}, {0: 1, 1: 2}, frozenset([0, 1])])
def test_rejects_unordered_weights(b):
    with pytest.raises(cg.TableauError, match="b must be a sequence of numbers, got"):
        cg.Tableau([[0, 0], [1, 0]], b)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"explicit": "no"}, "explicit must be True or False, got 'no'"),
        ({"nominal_order": True, "nominal_residual": 1}, "order must be an integer, got True"),
    ],
)
def test_tableau_rejects(changes, message):
    with pytest.raises(cg.TableauError, match=message):
        cg.Tableau([[], ["1/2"]], [0, 1], **changes)


@pytest.mark.parametrize("x", ["1", 5, None])
def test_make_method_rejects(x):
    with pytest.raises(ValueError, match="x must"):
        make_method(Layout.tableau(1), x)
    with pytest.raises(TypeError, match=r"digits must be an integer, got 1\.5"):
        make_method(Layout.tableau(1), [1], digits=1.5)


def test_certify_of_a_nameless_method():
    with pytest.raises(cg.CertificationError, match=r"^the method: the coefficients satisfy no"):
        cg.certify(cg.Tableau([[0]], [2]))


def test_digits_reject_other_certificates():
    method = cg.methods["CG5a"]
    with pytest.raises(TypeError, match="certificate must be a Certificate, got 'x'"):
        method.digits(20, certificate="x")
    with pytest.raises(TypeError, match="embedded must be True or False, got 'no'"):
        method.digits(20, embedded="no")
    # also for rational coefficients, which need no certificate for their digits
    with pytest.raises(cg.CertificationError, match="it is for 'CG3', not for 'CG5a'"):
        method.digits(20, certificate=cg.certify("CG3"))


def test_digits_prove_rational_methods():
    method = cg.methods["CG3"]
    certificate = certificate_of(method)
    a, b = method.exact
    wrong = cg.Tableau(a, [b[0] + 1, *b[1:]], name="CG3")
    assert method.digits(20, certificate=certificate)[1] == [str(entry) for entry in b]
    with pytest.raises(cg.CertificationError, match="is violated"):
        wrong.digits(20, certificate=certificate)


@pytest.mark.parametrize("value", [1, None, b"x"])
def test_catalogue_functions_reject(value, tmp_path):
    with pytest.raises(TypeError, match="text must be a str, got"):
        loads(value)
    with pytest.raises(TypeError, match="path must be a path, got"):
        load(value)
    with pytest.raises(TypeError, match="path must be a path, got"):
        save(cg.methods["CG3"], value)
    with pytest.raises(
        TypeError, match="method must be a Tableau, CommutatorFree, MuntheKaas or MagnusMethod"
    ):
        dumps(value)
    with pytest.raises(
        TypeError, match="method must be a Tableau, CommutatorFree, MuntheKaas or MagnusMethod"
    ):
        save(value, tmp_path / "method.toml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"ftol": HUGE}, ValueError, "ftol must be a finite number, not negative, got 1000"),
        ({"x0": np.ma.masked_array([1.0], mask=[1])}, TypeError, "x0 must hold real numbers"),
        ({"x0": [True]}, TypeError, r"x0 must hold real numbers, got \[True\]"),
        (
            {"f": lambda x: np.ma.masked_array([1.0], mask=[1])},
            TypeError,
            "f must return real numbers, got masked",
        ),
    ],
)
def test_lmdif_rejects(changes, error, message):
    arguments = {"f": lambda x: x - 1, "x0": [0.0]} | changes
    with pytest.raises(error, match=message):
        cg.lmdif(arguments.pop("f"), arguments.pop("x0"), **arguments)


CG3 = cg.methods["CG3"]
POINT = pack_method(CG3)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: pack_method("CG3"), TypeError, "method must be a Method, got 'CG3'"),
        (lambda: pack_method(CG3, 2.5), TypeError, r"order must be an integer, got 2\.5"),
        (lambda: ConditionSystem.tableau(True, 3), TypeError, "order must be an integer, got True"),
        (
            lambda: ConditionSystem.tableau(3, 3, "half"),
            ValueError,
            "rows must be one of explicit, diagonal, full",
        ),
        (lambda: Goals(bound="x"), ValueError, "bound must be a finite number, not negative"),
        (lambda: Goals(interval=(1, 0)), ValueError, "interval must be two increasing finite"),
        (lambda: Goals(abscissae=True), ValueError, "abscissae must be a finite number"),
        (lambda: optimise(None, Goals()), TypeError, "candidate must be a Candidate, got None"),
        (lambda: optimise(POINT, 3), TypeError, "goals must be Goals, got 3"),
        (lambda: fewer_exponentials(CG3), TypeError, "candidate must be a Candidate, got <Tableau"),
        (lambda: correct(POINT, [99]), ValueError, r"integers from 0 to 5, got \[99\]"),
        (lambda: correct(POINT, [1.5]), ValueError, r"frozen must be .*, got \[1\.5\]"),
        (
            lambda: to_method(POINT, name="", source="", frozen=3),
            ValueError,
            "frozen must be a sequence of integers from 0 to 5, got 3",
        ),
        (lambda: eliminate_stage(POINT, 3), ValueError, "stage must be at most 2, got 3"),
    ],
)
def test_construction_tools_reject(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"max_iterations": 1.5}, TypeError, r"max_iterations must be an integer, got 1\.5"),
        ({"max_iterations": -1}, ValueError, "max_iterations must be at least 0, got -1"),
        ({"tolerance": np.nan}, ValueError, "tolerance must be a finite number, not negative"),
        ({"frozen": ["a"]}, ValueError, r"frozen must be .*, got \['a'\]"),
    ],
)
def test_optimise_rejects(changes, error, message):
    with pytest.raises(error, match=message):
        optimise(POINT, Goals(), **changes)


def test_condition_system_converts_numpy_integers():
    system = ConditionSystem.tableau(np.int64(3), np.int64(3), 0)
    assert system == ConditionSystem.tableau(3, 3)
    assert repr(system) == repr(ConditionSystem.tableau(3, 3))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: encode([np.nan]), ValueError, "values must be finite real numbers, got nan"),
        (lambda: encode(["x"]), ValueError, "values must be finite real numbers, got 'x'"),
        (lambda: encode([1j]), ValueError, "values must be finite real numbers, got 1j"),
        (lambda: to_decimal(1, 1.5), TypeError, r"digits must be an integer, got 1\.5"),
        (lambda: decode(7), TypeError, "quads must be an array of int8, got 7"),
        (lambda: decode(np.zeros(16)), TypeError, "quads must be an array of int8, got float64"),
        (lambda: decode(np.int8([1])), ValueError, r"must have shape \(n, 16\), got \(1,\)"),
        (lambda: decode(np.zeros(16, np.int8)), ValueError, r"shape \(n, 16\), got \(16,\)"),
        (lambda: to_float([1.0]), TypeError, r"quads must be an array of int8, got \[1\.0\]"),
        (lambda: to_float(np.int8(1)), TypeError, "quads must be an array of int8, got"),
        (lambda: to_float(np.int8([[1]])), ValueError, r"16\), got \(1, 1\)"),
        (lambda: from_float("x"), ValueError, "values must be an array of real numbers, got 'x'"),
        (lambda: from_float(1j), ValueError, "values must be an array of real numbers, got 1j"),
        (lambda: forest(3).tree(1.0), TypeError, r"index must be an integer, got 1\.0"),
        (lambda: forest(3).tree("1"), TypeError, "index must be an integer, got '1'"),
        (lambda: forest(3).tree(True), TypeError, "index must be an integer, got True"),
        (lambda: forest(3).is_independent(None), TypeError, "index must be an integer, got None"),
        (lambda: forest(3).index([]), TypeError, r"tree must be an OrderedTree, got \[\]"),
        (lambda: forest(40), ValueError, "max_nodes must be between 1 and 14, got 40"),
        (lambda: forest(3).with_nodes(1.5), TypeError, r"nodes must be an integer, got 1\.5"),
        (lambda: prove("x", CG3), TypeError, "certificate must be a Certificate, got 'x'"),
        (
            lambda: prove(certificate_of(CG3), "CG3"),
            TypeError,
            "method must be a Method, got 'CG3'",
        ),
        (lambda: certificate_of("CG3"), TypeError, "method must be a Method, got 'CG3'"),
        (
            lambda: FreeRigidBody().reference([1], bits=1.5),
            TypeError,
            r"bits must be an integer, got 1\.5",
        ),
    ],
)
def test_quads_trees_and_proofs_reject(call, error, message):
    with pytest.raises(error, match=message):
        call()
