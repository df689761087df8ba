"""Options of the commands `search` and `construct` are the arguments of the functions."""

import inspect
import sys
from types import SimpleNamespace

import click
import pytest

import cg
from cg.command import main
from cg.command.searching import construct_command, search_command
from cg.construction.layouts.layout import Layout, Rows
from cg.construction.solvers.system import Structure

COMMANDS = {"search": (cg.search, search_command), "construct": (cg.construct, construct_command)}
OF_COMMANDS_ALONE = {"processes", "quiet", "output", "in_json"}
OF_FUNCTIONS_ALONE = {"executor", "progress"}  # which the options above stand for


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
        code = main(command.split())
        assert code == 1  # there is no method
        return calls.pop()

    return arguments_of


@pytest.mark.parametrize("name", COMMANDS)
def test_each_argument_has_an_option(name, arguments_of):
    function, command = COMMANDS[name]
    expected = inspect.signature(function).parameters
    options = {parameter.name: parameter for parameter in command.params}
    assert set(options) - OF_COMMANDS_ALONE == set(expected) - OF_FUNCTIONS_ALONE
    passed = arguments_of(f"{name} --order 4 --stages 5")
    assert passed.keys() == expected.keys()
    other = {"starts": 100, "seed": 0, "progress": True, "order": 4, "stages": 5}
    for key, parameter in expected.items():
        usual = other.get(key, parameter.default)
        assert passed[key] == usual, key
    assert all(isinstance(o, click.Option) and o.help for o in options.values())


def test_search_arguments(arguments_of):
    passed = arguments_of(
        "search --order 4 --stages 3 --rows diagonal --algorithm lmdif --width 0.5 --maxfev 70 "
        "--refine-below 1e-12 --refine-maxfev 9 --workers 1 --force --quiet"
    )
    assert (passed["rows"], passed["algorithm"]) == (Rows.DIAGONAL, "lmdif")
    assert [passed[k] for k in ("width", "maxfev", "refine_below", "refine_maxfev")] == [
        0.5, 70, 1e-12, 9
    ]  # fmt: skip
    assert (passed["workers"], passed["force"], passed["progress"]) == (1, True, False)
    passed = arguments_of(
        "search --order 4 --stages 5 --abscissae 0 1 --bound 2 --minimise principal_error"
    )
    assert [passed[k] for k in ("abscissae", "bound", "minimise")] == [(0, 1), 2, "principal_error"]
    passed = arguments_of("search --order 4 --stages 5 --flows 6 --embedded --first-same-as-last")
    assert (passed["flows"], passed["embedded"], passed["first_same_as_last"]) == (6, True, True)


def test_construct_arguments(arguments_of):
    passed = arguments_of(
        "construct --order 6 --stages 13 --structure stage-order-two --first-stages 14 "
        "--largest 2.5 --restarts 0 --iterations 30 --full-rank"
    )
    assert passed["structure"] == Structure.STAGE_ORDER_TWO
    keys = ("first_stages", "largest", "restarts", "iterations", "full_rank")
    assert [passed[key] for key in keys] == [14, 2.5, 0, 30, True]
    passed = arguments_of("construct --order 5 --stages 6 --flows 9 --first-flows 10")
    assert (passed["flows"], passed["first_flows"]) == (9, 10)


def test_tree_by_name_or_file(arguments_of, tmp_path):
    method = cg.methods["CF4"]
    file = tmp_path / "mine.toml"
    cg.construction.catalogue.save(method, file)
    for named in ("CF4", file):
        passed = arguments_of(f"search --order 4 --tree {named}")
        assert passed["tree"] == Layout.of_tree(method.tree)
        assert passed["stages"] == 4
    assert arguments_of("construct --order 4 --tree CF4 --stages 4")["tree"].stages == 4


def test_what_was_minimised_is_shown(capsys):
    command = "search --order 3 --stages 3 --starts 6 --seed 1 --quiet --minimise"
    assert main([*command.split(), "principal_error"]) == 0
    shown, note = capsys.readouterr()
    found = cg.search(3, 3, 6, 1, minimise="principal_error").methods
    errors = [float(line.rpartition("principal error ")[2]) for line in shown.splitlines()]
    assert errors == pytest.approx([method.principal_error for method in found], rel=1e-2)
    assert note == "each minimum is a local one: more --starts may lead to smaller ones\n"
    assert main([*command.split()[:-1], "--json"]) == 0
    assert capsys.readouterr().err == ""


def test_a_search_with_a_tree(capsys):
    assert main(["search", "--order", "4", "--tree", "CF4", "--starts", "10", "--quiet"]) == 0
    methods = cg.search(4, 4, 10, 0, tree=cg.methods["CF4"]).methods
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(", largest")[0] for line in lines] == list(map(repr, methods))
    command = ["construct", "--order", "5", "--stages", "6", "--flows", "9", "--first-flows", "10"]
    assert main([*command, "--seed", "1"]) == 0
    method = cg.construct(5, 6, 1, flows=9, first_flows=10).method
    assert cg.construction.catalogue.loads(capsys.readouterr().out) == method


def test_solutions_beyond_a_bound_are_counted(run_command):
    command = "search --order 3 --stages 3 --starts 4 --seed 1 --bound 0.1"
    exact = cg.search(3, 3, 4, 1).exact_starts
    assert exact > 0
    message = f"no method: {exact} found, but none with coefficients of at most 0.1\n"
    assert run_command(*command.split())[:2] == (1, message)
    result = cg.search(3, 3, 4, 1, abscissae=(0, 1), minimise="principal_error")
    assert "required to have abscissae from 0.0 to 1.0 and a small principal error>" in repr(result)


@pytest.mark.parametrize(("command", "message"), [
    ("search --order 4", "Missing option '--stages', or '--tree'"),
    ("search --order 4 --tree CF44", "Invalid value for '--tree': no method is named 'CF44'"),
    ("search --order 4 --tree DICG4", "isn't an explicit method with a tree of points"),
    ("search --order 4 --tree CF4 --stages 5", "--stages must be those of the tree, 4, got 5"),
    ("search --order 4 --tree CF4 --flows 5", "--flows and --tree exclude each other"),
    ("search --order 4 --stages 4 --flows 4", "--flows = 4 is too few for order 4, which"),
    ("search --order 4 --stages 5 --width x", "'x' is not a valid number."),
    ("search --order 4 --tree CF4 --first-same-as-last", "--tree exclude each other"),
    ("search --order 4 --tree CF4 --embedded", "--embedded can't be used, as --tree has no"),
    ("search --order 4 --stages 5 --width -1", "Invalid value for '--width'"),
    ("search --order 4 --stages 5 --embedded", "--embedded needs --flows; "),
    ("search --order 4 --stages 5 --first-same-as-last", "--first-same-as-last needs"),
    ("construct --order 5 --stages 9 --structure middle --full-rank", "--structure must be"),
    ("construct --order 5 --stages 9 --first-stages 3", "--first-stages must be at least 9"),
])  # fmt: skip
def test_errors_name_the_option(command, message, capsys):
    assert main(command.split()) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
