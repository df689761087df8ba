"""Functions that search, prove, lift and solve refuse bad input by name, before they compute."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from refusals import refuses

import cg
from cg import conditions
from cg.construction.catalogue import dumps, load, loads, resolve_method, save
from cg.construction.conditions import MAX_ORDER, Rows, check_rows, count, unknowns
from cg.construction.layouts import Layout
from cg.construction.proofs import certificate_of
from cg.construction.proofs import check as prove
from cg.construction.search.candidate import make_method, pack_method
from cg.construction.search.optimise import optimise
from cg.construction.solvers.system import ConditionSystem
from cg.construction.trees import forest
from cg.problems import FreeRigidBody

exactly = partial(conditions.residuals, arithmetic="exact")
HUGE = 10**400
MASKED = np.ma.masked_array([[0.0, 0.0], [1.0, 0.0]], mask=[[0, 0], [1, 0]])
CG3, CG5A, CF4 = (cg.methods[name] for name in ("CG3", "CG5a", "CF4"))
POINT = pack_method(CG3)
HALF, EULER = [[], ["1/2"]], [[0, 0], [1, 0]]


def search(**changes):
    return cg.search(**{"order": 2, "stages": 2, "starts": 1, "seed": 0} | changes)


def construct(**changes):
    return cg.construct(**{"order": 3, "stages": 3, "seed": 0, "tries": 1} | changes)


def lmdif(f=lambda x: x - 1, x0=(0.0,), **changes):
    return cg.lmdif(f, x0, **changes)


def masked(x):
    return np.ma.masked_array([1.0], mask=[1])


@pytest.mark.parametrize(("call", "error", "message"), [
    (lambda: search(rows=True), ValueError, "rows must be one of explicit, diagonal, full"),
    (lambda: search(force="no"), TypeError, "force must be True or False, got 'no'"),
    (lambda: search(stages=1001), ValueError, "stages must be at most 1000, got 1001"),
    (lambda: construct(width=1e308), ValueError, r"width must be at most 1e\+300"),
    (lambda: construct(force=None), TypeError, "force must be True or False, got None"),
    (lambda: construct(first_stages=10**6), ValueError, "first_stages must be at most 1000"),
    (lambda: lmdif(x0=[True]), ValueError, r"x0 must be an array of real numbers, got \[True\]"),
    (lambda: lmdif(masked), ValueError, "residuals must be an array of real numbers, got masked"),
    (lambda: cg.certify("CG9z"), ValueError, r"got 'CG9z'; similar names are CG4"),
    (lambda: cg.certify(cg.Tableau([[0]], [2])), cg.CertificationError,
     "^the method: the coefficients satisfy no"),
    (lambda: resolve_method("CF54"), ValueError, r"got 'CF54'; similar names are CF5\(4\)$"),
    (lambda: resolve_method("rkmk853"), ValueError, r"names are RKMK8\(5,3\)$"),
    (lambda: resolve_method("CF44"), ValueError, r"similar names are (?!.*CFM)"),
    (lambda: resolve_method("CFM5"), ValueError, r"similar names are CFM"),
    (lambda: conditions.residuals(CF4.a, CF4.b, 4), ValueError, "residuals.method"),
    (lambda: conditions.pack(CF4.a[:3, :3], [1, 0, 0]), ValueError, "residuals.method"),
    (lambda: exactly(CF4.a, CF4.b, 4), ValueError, "residuals.method"),
    (lambda: count(99), ValueError, "order must be at most 13, got 99"),
    (lambda: exactly([[0]], [1], 99), ValueError, "order must be at most 13"),
    (lambda: CG3.max_residual(99), ValueError, "order must be at most 13, got 99"),
    (lambda: exactly(MASKED, [0, 1], 2), ValueError, "row 2 of a must hold finite"),
    (lambda: exactly([[0]], [np.inf], 2), ValueError, "b must hold finite real numb"),
    (lambda: exactly([[1j]], [1], 2), ValueError, "row 1 of a must hold finite real"),
    (lambda: exactly([[0]], ["x"], 2), ValueError, "b must hold finite .* got 'x'"),
    (lambda: exactly([["1/0"]], [1], 2), ValueError, "row 1 of a must .* got '1/0'"),
    (lambda: exactly([[0]], 1, 2), ValueError, "b must be a sequence of numbers"),
    (lambda: cg.Tableau(EULER, {0, 1}), cg.TableauError, "b must be a sequence of numbers"),
    (lambda: cg.Tableau(HALF, [0, 1], nominal_order=True, nominal_residual=1), cg.TableauError,
     "order must be an integer, got True"),
    *(
        (lambda x=x: make_method(Layout.tableau(1), x), ValueError, "x must")
        for x in ("1", 5, None)
    ),
    *((lambda s=s: unknowns(s), TypeError, "stages must be an integer") for s in (True, 1.0)),
    (lambda: cg.digits(CG5A, 20, certificate="x"), TypeError, "must be a Certificate"),
    (lambda: cg.digits(CG5A, 20, embedded="no"), TypeError, "embedded must be True or False"),
    # also for rational coefficients, which need no certificate for their digits
    (lambda: cg.digits(CG5A, 20, certificate=cg.certify("CG3")), cg.CertificationError,
     "it is for 'CG3', not for 'CG5a'"),
    *((lambda v=v: loads(v), TypeError, "text must be a str, got") for v in (1, None, b"x")),
    *((lambda v=v: load(v), TypeError, "path must be a path, got") for v in (1, None, b"x")),
    *((lambda v=v: save(CG3, v), TypeError, "path must be a path") for v in (1, None, b"x")),
    *((lambda v=v: dumps(v), TypeError, "method must be a Tableau,") for v in (1, None, b"x")),
    (lambda: save(1, "method.toml"), TypeError, "method must be a Tableau,"),
    (lambda: ConditionSystem.tableau(True, 3), TypeError, "order must be an integer, got True"),
    (lambda: ConditionSystem.tableau(3, 3, "half"), ValueError, "rows must be one of explicit"),
    (lambda: optimise(None), TypeError, "candidate must be a Candidate, got None"),
    (lambda: optimise(POINT, coefficients=True), TypeError, "coefficients must be a real"),
    (lambda: optimise(POINT, max_iterations=1.5), TypeError, "max_iterations must be"),
    *((lambda i=i: forest(3).tree(i), TypeError, "index must be an int") for i in (1.0, "1")),
    (lambda: forest(3).is_independent(None), TypeError, "index must be an integer, got None"),
    (lambda: forest(3).index([]), TypeError, r"tree must be an OrderedTree, got \[\]"),
    (lambda: forest(40), ValueError, "max_nodes must be between 1 and 14, got 40"),
    (lambda: forest(3).with_nodes(1.5), TypeError, r"nodes must be an integer, got 1\.5"),
    (lambda: prove("x", CG3), TypeError, "certificate must be a Certificate, got 'x'"),
    (lambda: prove(certificate_of(CG3), "CG3"), TypeError, "method must be a Method"),
    (lambda: certificate_of("CG3"), TypeError, "method must be a Method, got 'CG3'"),
    (lambda: FreeRigidBody().reference([1], bits=1.5), TypeError, "bits must be an integer"),
])  # fmt: skip
def test_bad_arguments_are_rejected(call, error, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refuses(error, message, call)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [[1], {}, np.array([1]), slice(1)])
def test_method_names_must_be_strings(name):
    with pytest.raises(TypeError, match="the name of a method must"):
        cg.methods[name]
    assert name not in cg.methods
    assert None not in cg.methods
    assert cg.methods.get(1) is None


@pytest.mark.parametrize("function", [
    count, conditions.condition_trees, conditions.table_rows, conditions.right_sides,
    lambda order: conditions.residuals([[0]], [1], order),
    lambda order: exactly([[0]], [1], order),
    CG3.max_residual,
])  # fmt: skip
def test_orders_must_be_integers(function):
    function(1)  # the cached result for 1 must not serve True
    for order in (True, 2.5):
        refuses(TypeError, f"order must be an integer, got {order}", function, order)


PAIR = ([[0.0, 0.0], [0.5, 0.0]], [0.0, 1.0])


@pytest.mark.parametrize("function", [
    lambda a, b: conditions.residuals(a, b, 2),
    lambda a, b: conditions.jacobian(a, b, 2),
    lambda a, b: conditions.weights(a, b, 2),
    conditions.pack,
])  # fmt: skip
def test_coefficients_must_be_arrays_of_real_numbers(function):
    a, b = map(np.array, PAIR)
    function(a, b)
    for wrong in (MASKED, [[HUGE, 0], [0, 0]], a * 1j, a * (1 + 0j), a.astype(str)):
        refuses(ValueError, "^a must", function, wrong, b)
    objects = [np.array([0, x], dtype=object) for x in (1j, np.complex64(1), "1", None)]
    for wrong in ([HUGE, 0], (b * 1j).tolist(), *objects):
        refuses(ValueError, "^b must", function, a, wrong)


def test_numbers_of_numpy_are_accepted():
    result = cg.search(2, np.int64(2), 1, 0, width=np.float32(0.5), rows=np.int64(0))
    assert result.settings == cg.search(2, 2, 1, 0, width=0.5).settings
    exact = exactly(np.float32([[0, 0], [0.5, 0]]), np.float32([0, 1]), 2)
    assert exact == (0, 0, 0)
    system = ConditionSystem.tableau(np.int64(3), np.int64(3), 0)
    assert system == ConditionSystem.tableau(3, 3)
    assert repr(system) == repr(ConditionSystem.tableau(3, 3))
    assert unknowns(10**9, "full") == 10**18 + 10**9
    for rows in Rows:
        assert unknowns(7, rows) == Layout.tableau(7, rows).size
    assert check_rows("full") is check_rows(2) is Rows.FULL


NAN, MANY = float("nan"), 10**30
CHAIN = (tuple(range(-1, 8)), (-1, 0, 1, 3, 4, 7))  # six stages
CLASSICAL = cg.methods["RKMK4"].tableau


def never(x):
    raise AssertionError("f was called")


BOTH = {
    "order": [0, 99], "stages": [0, MANY], "seed": [-1], "workers": [0], "progress": ["yes"],
    "executor": ["fast", 3, ThreadPoolExecutor], "tree": ["x", ((-1,),), (3, (-1,))],
    "flows": [5, True], "embedded": [1], "first_same_as_last": [True],
}  # fmt: skip
OF_SEARCH = {
    "starts": [0, MANY], "maxfev": [0, MANY], "refine_maxfev": [0, MANY], "algorithm": ["newton"],
    "rows": ["lower"], "width": [-0.5, NAN, 1e308], "refine_below": [-1],
    "abscissae": [(1, 0), 1.0, (0, np.inf), "01"], "minimise": ["flows"],
    "bound": [0, {"x": (0, 1)}, {"b": (1, 0)}, {"b": 1}, {3: (0, 1)}, {"c": ("0", 1)}],
    "nonnegative": [3, "", [2]],
}  # fmt: skip
CONSTRUCT = {"tries": [0, MANY], "iterations": [MANY], "max_coefficient": [0], "first_stages": [2]}
LIFT = {
    "tableau": [cg.methods["CF3"], cg.methods["ImplicitMidpoint"]], "order": [0, 5],
    "chains": [[1, 1], [1, 1, 0, 1]], "flows": [3], "tries": [0],
    "hits": [0], "seed": [-1], "reduce": ["no"],
}  # fmt: skip
LMDIF = {
    "f": [3], "x0": [[[1.0, 2.0]], 1.0, [1.0, NAN], ["a", "b"], [[1.0], [1.0, 2.0]]],
    "ftol": [-1e-8], "xtol": [-1e-8], "gtol": [-1e-8, "small"], "epsfcn": [-1e-8], "factor": [0.0],
    "maxfev": [0, 2**31, 10.0], "diag": [[1.0], [1.0, 0.0]],
}  # fmt: skip
SHAPES = [
    {"tree": CHAIN, "first_same_as_last": True}, {"tree": CHAIN, "stages": 7},
    {"tree": CHAIN, "embedded": True}, {"flows": 9, "first_same_as_last": 2},
    {"flows": 9, "embedded": 1},
]  # fmt: skip


def cases(function, good, table, *others):
    """Return calls, each with one argument or some of them changed, of which the last is bad."""
    changes = [{name: value} for name, values in table.items() for value in values]
    return [(function, good | change, [*change][-1]) for change in [*changes, *others]]


GOOD = {"order": 5, "stages": 6, "seed": 1, "force": True}


@pytest.mark.parametrize(("function", "arguments", "name"), [
    *cases(cg.search, GOOD | {"starts": 1}, BOTH | OF_SEARCH, *SHAPES),
    *cases(cg.search, GOOD | {"starts": 1}, {}, {"minimise": "principal_error"}
           | {"order": MAX_ORDER}),
    *cases(cg.search, GOOD | {"starts": 1}, {}, {"embedded": True, "algorithm": "lmdif"},
           {"flows": 9, "bound": {"b": (0, 1)}},
           {"force": False, "stages": 9, "nonnegative": "b"},
           {"force": False, "stages": 9, "bound": {"b": (0, None)}, "nonnegative": ()}),
    *cases(cg.construct, GOOD, BOTH | CONSTRUCT, *SHAPES),
    *cases(cg.lift, {"tableau": CLASSICAL}, LIFT, {"chains": [1, 1, 1, 2], "flows": 5}),
    *cases(cg.lmdif, {"f": never, "x0": [-1.2, 1.0]}, LMDIF),
    *cases(cg.lmdif, {}, {}, {"x0": [1.0, 1.0, 1.0], "f": lambda x: x[:2]},
           {"x0": [1.0, 1.0], "f": lambda x: np.where(x > 1, 1e308, -1e307)}),
])  # fmt: skip
def test_bad_arguments_of_solvers_are_named(function, arguments, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stored = {"store": "runs.jsonl"} if "force" in arguments else {}
    refuses((TypeError, ValueError), rf"\b{name}\b", function, **arguments, **stored)
    assert not list(tmp_path.iterdir())
