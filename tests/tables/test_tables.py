"""Tables of methods: those stored are those compiled, and integrations read nothing else."""

import copy
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.catalogue import methods, stored_methods
from cg.construction.methods.compile import compiled
from cg.tables import stored_names, stored_table, table_of, unique_table

METHODS = {method.name: method for method in stored_methods()}
MAKING = {"conditions", "construction"}
SO3 = cg.frames.SO3()


def spin(t, y):
    return [np.sin(t), 0.3, 1.0]


THETAS = np.linspace(0, 1, 41)[:, None]
ROUNDING = {"rows": 1e-10, "basis": 1e-9, "blend": 1e-10}  # solutions of least squares


def assert_same(one, other, entry=""):
    """Compare all that a table holds; numbers within the rounding of LAPACK's kernels."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key], key)
    elif np.asarray(one).dtype != np.float64:
        assert one == other
    else:
        one, other = np.asarray(one), np.asarray(other)
        if entry in ("basis", "blend"):  # polynomials by their powers: compare values
            one, other = (THETAS ** np.arange(len(powers)) @ powers for powers in (one, other))
        scale = max(1.0, np.abs(one).max(initial=0.0))
        np.testing.assert_allclose(other, one, rtol=0, atol=ROUNDING.get(entry, 1e-13) * scale)


def test_all_methods_are_stored():
    assert stored_names() == list(METHODS)
    assert set(methods) < set(METHODS)


@pytest.mark.parametrize("name", list(METHODS))
def test_stored_tables_are_the_compiled_ones(name):
    method = METHODS[name]
    limit = methods.summaries.get(name, {}).get("real_stability")
    fresh = replace(compiled(method), real_stability=limit)
    assert_same(stored_table(name).as_dict(), fresh.as_dict())


def test_changed_tables_change_steps():
    """The table is what is read: a weight that is off changes the solution."""

    class Changed:
        def table(self):
            table = stored_table("CF4")
            return replace(table, arrays=table.arrays | {"weight": 1.001 * table.arrays["weight"]})

    options = {"frame": SO3, "h": 0.1}
    right, wrong = (
        cg.solve_ivp(spin, (0, 1), np.eye(3), method=method, **options)
        for method in ("CF4", Changed())
    )
    assert 1e-4 < np.abs(right.y[-1] - wrong.y[-1]).max() < 1e-2


def test_integrations_do_not_load_what_makes_methods():
    script = (
        "import sys, cg\n"
        "for frame, y in ((cg.frames.SO3(), [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),\n"
        "                 (cg.frames.Euclidean(3), [1, 0, 0])):\n"
        "    for method in ('auto', 'CF5(4)', 'RadauIIA5'):\n"
        "        cg.solve_ivp(lambda t, y: [0, 0, 1.0], (0, 1), y, frame=frame, method=method)\n"
        "print(*{m.split('.')[1] for m in sys.modules if m.startswith('cg.')})\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "integration" in run.stdout.split()
    assert not MAKING & set(run.stdout.split())


def test_solutions_name_their_method():
    solution = cg.solve_ivp(spin, (0, 1), np.eye(3), frame=SO3, method="CF5(4)")
    assert solution.method is methods["CF5(4)"]
    own = cg.Tableau([[], ["1/2"]], [0, 1])
    assert cg.solve_ivp(spin, (0, 1), np.eye(3), frame=SO3, method=own, h=0.5).method is own
    generator = np.array([[[0, 1.0], [-1, 0]]])
    frame = cg.frames.LinearAction(generator)
    linear = cg.solve_linear(lambda t: [1.0], (0, 1), [1.0, 0], frame=frame)
    assert linear.method.name == "Lobatto's formula"
    assert len(linear.method.c) == 9
    assert "order 16 along a polynomial, 9 evaluations" in repr(linear.method)


def test_pickles_of_tables():
    stored = stored_table("CF4")
    assert pickle.loads(pickle.dumps(stored)) is stored
    own = cg.Tableau([[], ["1/2"]], [0, 1], name="own")
    assert pickle.loads(pickle.dumps(own.table())).as_dict() == own.table().as_dict()
    assert unique_table(own) is pickle.loads(pickle.dumps(unique_table(own)))


LIKE_CFM4 = cg.MagnusMethod(METHODS["CFM4"].nodes, METHODS["CFM4"].weights, name="own")


@pytest.mark.parametrize("method", ["CFM4", LIKE_CFM4])
def test_pickles_and_copies_of_tables_along_a_polynomial(method):
    table = table_of(method)
    for again in (pickle.loads(pickle.dumps(table.polynomial)), copy.copy(table.polynomial)):
        assert again.is_polynomial
        assert again.as_dict() == table.polynomial.as_dict()
    assert pickle.loads(pickle.dumps(table)).as_dict() == table.as_dict()


def test_methods_that_are_none():
    class Wrong:
        def table(self):
            return 3

    assert table_of("CF4") is stored_table("CF4")
    refuses(TypeError, r"method.table\(\) must return a MethodTable, got 3", table_of, Wrong())
    refuses(TypeError, "method must be a name, a path, or a Method, got 3", table_of, 3)
    refuses(ValueError, "method must be the name of a method, got 'CF'", table_of, "CF")
