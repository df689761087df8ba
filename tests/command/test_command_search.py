"""Options of the commands `search` and `construct` are the arguments of the functions."""

import inspect
import json

import pytest

import cg
from cg.command import main, searching
from cg.construction.catalogue import load, loads, save
from cg.construction.layouts import Rows
from cg.construction.solvers.system import Structure
from cg.support.parallel import has_bars


@pytest.fixture
def arguments_of(monkeypatch):
    """Replace the functions; return a function of a command that returns their arguments."""
    calls = []

    def note(**arguments):
        calls.append(arguments)
        raise ValueError

    monkeypatch.setattr(searching, "search", note)
    monkeypatch.setattr(searching, "construct", note)

    def arguments_of(command):
        assert main(command.split()) == 2
        return calls.pop()

    return arguments_of


@pytest.mark.parametrize("name", ["search", "construct"])
def test_defaults_are_those_of_the_function(name, arguments_of):
    parameters = inspect.signature(getattr(cg, name)).parameters
    expected = {key: parameter.default for key, parameter in parameters.items()}
    expected |= {"progress": has_bars(), "order": 4, "stages": 5}
    assert arguments_of(f"{name} --order 4 --stages 5") == expected


def test_arguments(arguments_of, tmp_path):
    passed = arguments_of(
        "search --order 4 --stages 3 --rows diagonal --algorithm lmdif --width 0.5 --maxfev 70 "
        "--refine-below 1e-12 --workers 1 --force --quiet --processes --abscissae 0 1 --bound 2 "
        "--minimise principal_error --hold c[2]=1/2 --hold b[2]=0 --nonnegative a"
    )
    expected = {
        "rows": Rows.DIAGONAL, "algorithm": "lmdif", "width": 0.5, "maxfev": 70,
        "refine_below": 1e-12, "workers": 1, "force": True, "progress": False,
        "executor": "processes", "abscissae": (0, 1), "bound": 2, "minimise": "principal_error",
        "nonnegative": ("a",), "hold": {"c[2]": "1/2", "b[2]": "0"}, "order": 4, "stages": 3,
    }  # fmt: skip
    assert {key: passed[key] for key in expected} == expected
    passed = arguments_of("search --order 4 --stages 5 --bound b[2]=0: --bound c=-1:1")
    assert passed["bound"] == {"b[2]": [0, None], "c": [-1, 1]}
    passed = arguments_of("construct --order 6 --stages 13 --structure stage_order_two --force")
    assert (passed["structure"], passed["force"]) == (Structure.STAGE_ORDER_TWO, True)
    save(cg.methods["CF4"], tmp_path / "mine.toml")
    for named in ("CF4", tmp_path / "mine.toml"):
        passed = arguments_of(f"search --order 4 --tree {named}")
        assert (passed["tree"], passed["stages"]) == (cg.methods["CF4"], 4)


def test_results(run_command, tmp_path):
    command = "search --order 3 --stages 3 --starts 8 --seed 1 --quiet --json -o"
    code, output, _ = run_command(*command.split(), str(tmp_path / "found"))
    methods = [loads(json.dumps(entry)) for entry in json.loads(output)]
    assert code == 0
    assert set(methods) == set(cg.search(3, 3, 8, 1).methods)
    assert {load(path) for path in (tmp_path / "found").iterdir()} == set(methods)
    command = "search --order 3 --stages 3 --starts 6 --seed 1 --quiet --minimise principal_error"
    _, shown, _ = run_command(*command.split())
    found = cg.search(3, 3, 6, 1, minimise="principal_error").methods
    assert shown.splitlines() == [
        f"{method!r}, principal error {method.principal_error:.3g}" for method in found
    ]
    command = "search --order 3 --stages 3 --starts 4 --seed 1 --bound 0.1"
    message = f"no method: {cg.search(3, 3, 4, 1, bound=0.1)!r}\n"
    assert run_command(*command.split())[:2] == (1, message)
    command = "construct --order 4 --stages 4 --tries 1 --force"
    message = f"no method: {cg.construct(4, 4, tries=1, force=True)!r}\n"
    assert run_command(*command.split())[:2] == (1, message)
    command = "construct --order 5 --stages 6 --flows 9 --first-flows 10 --seed 1"
    method = cg.construct(5, 6, 1, flows=9, first_flows=10).method
    assert loads(run_command(*command.split())[1]) == method
