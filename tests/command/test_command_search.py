"""Options of the commands `search` and `construct` are the arguments of the functions."""

import inspect
import json
import sys
from types import SimpleNamespace

import pytest

import cg
from cg.command import main
from cg.command.searching import construct_command, search_command
from cg.construction.catalogue import load, loads, save
from cg.construction.layouts import Layout, Rows
from cg.construction.solvers.system import Structure
from cg.support.parallel import has_bars

COMMANDS = {"search": (cg.search, search_command), "construct": (cg.construct, construct_command)}


@pytest.fixture
def arguments_of(monkeypatch):
    """Replace the functions; return a function of a command that returns their arguments."""
    calls = []

    def note(**arguments):
        calls.append(arguments)
        return SimpleNamespace(methods=(), method=None)

    module = sys.modules["cg.command.searching"]
    for name in COMMANDS:
        monkeypatch.setattr(module, name, note)

    def arguments_of(command):
        assert main(command.split()) == 1  # there is no method
        return calls.pop()

    return arguments_of


@pytest.mark.parametrize("name", COMMANDS)
def test_defaults_are_those_of_the_function(name, arguments_of):
    function, command = COMMANDS[name]
    expected = inspect.signature(function).parameters
    passed = arguments_of(f"{name} --order 4 --stages 5")
    assert passed.keys() == expected.keys()
    given = {"progress": has_bars(), "order": 4, "stages": 5}
    for key, parameter in expected.items():
        assert passed[key] == given.get(key, parameter.default), key
    assert all(option.help for option in command.params)


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
        "nonnegative": ("a",),
        "hold": {"c[2]": "1/2", "b[2]": "0"}, "order": 4, "stages": 3,
    }  # fmt: skip
    assert {key: passed[key] for key in expected} == expected
    passed = arguments_of("search --order 4 --stages 5 --bound b[2]=0: --bound c=-1:1")
    assert passed["bound"] == {"b[2]": [0, None], "c": [-1, 1]}
    passed = arguments_of("construct --order 6 --stages 13 --structure stage_order_two --force")
    assert (passed["structure"], passed["force"]) == (Structure.STAGE_ORDER_TWO, True)
    file = tmp_path / "mine.toml"
    save(cg.methods["CF4"], file)
    for named in ("CF4", file):
        passed = arguments_of(f"search --order 4 --tree {named}")
        assert passed["tree"] == Layout.of_tree(cg.methods["CF4"].tree)
        assert passed["stages"] == 4


def test_results(run_command, tmp_path):
    command = "search --order 3 --stages 3 --starts 8 --seed 1 --quiet --json -o"
    code, output, _ = run_command(*command.split(), str(tmp_path / "found"))
    methods = [loads(json.dumps(entry)) for entry in json.loads(output)]
    assert code == 0
    assert set(methods) == set(cg.search(3, 3, 8, 1).methods)
    assert {load(path) for path in (tmp_path / "found").iterdir()} == set(methods)
    command = "search --order 3 --stages 3 --starts 6 --seed 1 --quiet --minimise principal_error"
    _, shown, note = run_command(*command.split())
    found = cg.search(3, 3, 6, 1, minimise="principal_error").methods
    errors = [float(line.rpartition("principal error ")[2]) for line in shown.splitlines()]
    assert errors == pytest.approx([method.principal_error for method in found], rel=1e-2)
    assert note == "each minimum is a local one: more --starts may lead to smaller ones\n"
    command = "search --order 3 --stages 3 --starts 4 --seed 1 --bound 0.1"
    exact = cg.search(3, 3, 4, 1).exact_starts
    message = f"no method: {exact} found, but none with coefficients in [-0.1, 0.1]\n"
    assert run_command(*command.split())[:2] == (1, message)
    command = "search --order 4 --stages 4 --starts 1 --force"
    assert run_command(*command.split())[:2] == (1, "no method found\n")
    command = "construct --order 5 --stages 6 --flows 9 --first-flows 10 --seed 1"
    method = cg.construct(5, 6, 1, flows=9, first_flows=10).method
    assert loads(run_command(*command.split())[1]) == method


@pytest.mark.parametrize(("command", "message"), [
    ("search --order 4", "Missing option '--stages', or '--tree'"),
    ("search --order 4 --tree CF44", "Invalid value for '--tree': no method is named 'CF44'"),
    ("search --order 4 --tree DICG4", "isn't an explicit method with a tree of points"),
    ("search --order 4 --tree CF4 --stages 5", "--stages must be those of the tree, 4, got 5"),
    ("search --order 4 --tree CF4 --flows 5", "--flows must not be given with a tree, got 5"),
    ("search --order 4 --stages 3 --flows 4", "--stages = 3 is too few for order 4, which"),
    ("search --order 4 --stages 5 --width x", "'x' is not a valid number."),
    ("search --order 4 --tree CF4 --embedded", "--embedded must be False, as tree has no"),
    ("search --order 4 --stages 5 --width -1", "--width must be"),
    ("search --order 4 --stages 5 --bound 1 --bound b=0:", "--bound: give one number"),
    ("search --order 4 --stages 5 --hold x", "'x' isn't NAME=VALUE"),
    ("search --order 4 --stages 5 --hold b[2]=0 --hold b[2]=1", "--hold gives two values"),
    ("construct --order 5 --stages 9 --first-stages 3", "--first-stages must be at least 9"),
])  # fmt: skip
def test_errors_name_the_option(command, message, capsys):
    assert main(command.split()) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
