"""Modules imported by the package and its functions."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import cg

pytestmark = pytest.mark.no_core

HEAVY = {"flint", "matplotlib", "numpy", "scipy", "threadpoolctl"}


def loaded_after(code):
    """Return the names of the modules that a fresh interpreter has loaded after some code."""
    report = "\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    process = subprocess.run(
        [sys.executable, "-c", code + report], capture_output=True, text=True, check=True
    )
    return set(json.loads(process.stdout.splitlines()[-1]))


def test_submodules_are_imported_lazily():
    modules = loaded_after("import cg; dir(cg)")
    assert not HEAVY & modules
    assert not [name for name in modules if name.startswith("cg.")]


def test_methods_need_neither_scipy_nor_flint():
    modules = loaded_after("import cg; cg.methods['CG4a'].a; list(cg.methods); cg.Tableau")
    assert "numpy" in modules
    assert not {"flint", "matplotlib", "scipy"} & modules
    assert "cg.construction.proofs" not in modules


def test_integration_imports_no_unused_modules():
    modules = loaded_after(
        "import cg\n"
        "f = lambda t, y: [0.1, 0.2, 0.3]\n"
        "frame = cg.frames.SO3()\n"
        "cg.integrate(f, (0, 1), [[1, 0, 0], [0, 1, 0], [0, 0, 1]], frame=frame, h=0.5,\n"
        "             method='CG4a')\n"
        "cg.solve_ivp(f, (0, 1), [[1, 0, 0], [0, 1, 0], [0, 0, 1]], frame=frame)"
    )
    unused = {"cg.construction", "cg.problems", "matplotlib"}
    unused |= {"cg.jax", "jax", "diffrax"}
    unused |= {
        f"scipy.{part}" for part in ("integrate", "interpolate", "linalg", "optimize", "sparse")
    }
    assert not unused & modules


def test_public_names_equal_the_stub():
    stub = ast.parse(Path(cg.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    (listed,) = (
        [element.value for element in node.value.elts]
        for node in stub.body
        if isinstance(node, ast.Assign)
    )
    assert sorted(listed) == sorted(cg.__all__)
    assert dir(cg) == sorted([*listed, "jax", "__version__"])
    for name in listed:
        assert getattr(cg, name) is not None


def test_attributes_of_the_package():
    assert cg.construction.catalogue.methods is cg.methods
    with pytest.raises(AttributeError, match="module 'cg' has no attribute 'method_s'"):
        cg.method_s  # noqa: B018
    assert not hasattr(cg, "__wrapped__")


def test_missing_jax_error_names_the_package():
    code = (
        "import sys; sys.modules['diffrax'] = None; import cg\n"
        "try:\n    cg.jax\nexcept ImportError as error:\n    print(error)"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert (
        out == "cg.jax needs jax and diffrax: python -m pip install '.[jax]' in the source tree\n"
    )


WITHOUT_FLINT = """
import sys; sys.modules["flint"] = None
import numpy as np
import cg
from cg.command import main
f, frame = lambda t, y: np.array([t, 0, 1.0]), cg.frames.SO3()
for method in ("auto", "CF5(4)", "CG4", "RadauIIA5", "RKMK5(4)"):
    options = {"h": 0.1} if method == "CG4" else {}
    assert cg.solve_ivp(f, (0, 1), np.eye(3), frame=frame, method=method, **options).success
cg.solve_linear(lambda t: np.array([t, 0, 1.0]), (0, 1), np.eye(3), frame=frame)
cg.solve_variational(f, (0, 1), np.eye(3), frame=frame, method="CF4", h=0.1)
assert main(["list", "--order", "4", "--json"]) == 0
for name in ("CG4", "CF4(3)", "RKMK5(4)", "CFM4", "BlanesMoan4", "DICG4"):
    again = cg.methods.read_again(name)
    assert again.order == cg.methods[name].order, name
def started(*given): raise RuntimeError("an unrefined result was computed")
for name in ("search.start", "search.construct", "lifting.lift"):
    module = __import__(f"cg.construction.{name}", fromlist=["x"])
    module.start_generator = started
searches = lambda: cg.search(3, 3, 1, 1), lambda: cg.construct(3, 3), lambda: cg.lift(method)
method = cg.Tableau([[], ["1/2"]], ["0", "1"])
for call in (*searches, lambda: cg.certify("CG3"), lambda: cg.problems.HeavyTop()):
    try:
        call()
    except ImportError as error:
        assert str(error).endswith("the extra [proofs]: python -m pip install python-flint")
    else:
        raise AssertionError
"""


def test_only_proofs_and_references_need_flint():
    loaded_after(WITHOUT_FLINT)


@pytest.mark.parametrize(
    "arguments", ["certify CG3", "export CG5a json --digits 50", "search --order 2 --stages 2"]
)
def test_commands_name_what_they_need(arguments):
    code = (
        "import sys; sys.modules['flint'] = None\n"
        "from cg.command.main import main\nsys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, *arguments.split()]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 3
    (line,) = run.stderr.splitlines()
    assert line.startswith("crouch-grossman: error: ")
    assert line.endswith("the extra [proofs]: python -m pip install python-flint")


def test_the_stub_has_the_procedures_of_the_compiled_core():
    from cg import _core_r64

    stub = ast.parse((Path(cg.__file__).parent / "_core_r64.pyi").read_text("utf-8"))
    typed = {
        node.name: [argument.arg for argument in node.args.args]
        for node in stub.body
        if isinstance(node, ast.FunctionDef)
    }
    calls = [
        getattr(_core_r64, name).__doc__.split("\n")[0].split(" = ")[-1]
        for name in dir(_core_r64)
        if not name.startswith("_")
    ]
    assert typed == {
        call.split("(")[0]: call.split("(")[1].rstrip(")").split(",[")[0].split(",")
        if "()" not in call
        else []
        for call in calls
    }
