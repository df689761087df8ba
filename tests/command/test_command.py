"""The command, run in this process and in others: help, certify, export, errors."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import pytest

import cg
from cg.command import proving, searching
from cg.command.arguments import METHOD
from cg.construction.catalogue import dumps

COMMANDS = ["list", "show", "check", "search", "construct", "certify", "export"]


def process(*arguments):
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_help_has_examples(run_command):
    code, output, _ = run_command("--help")
    assert code == 0
    listed = re.findall(r"^  (\w+)  ", output.partition("Commands:")[2], re.MULTILINE)
    assert listed == COMMANDS
    for name in COMMANDS:
        code, output, _ = run_command(name, "--help")
        assert code == 0
        assert f"crouch-grossman {name}" in output.partition("Examples:")[2]
        assert ("--json" in output) == (name != "export")
    assert run_command("--version") == (0, f"crouch-grossman {cg.__version__}\n", "")


def test_processes():
    code = "import sys, cg.command; cg.command.main(['--version'])\nprint(*sys.modules)"
    loaded = set(process("-c", code).stdout.split())
    assert "click" in loaded
    assert not {"numpy", "scipy", "flint", "cg.command.searching"} & loaded
    completed = process("-m", "cg", "show", "CG33")
    assert (completed.returncode, completed.stdout) == (2, "")
    assert completed.stderr.startswith("python -m cg: error: Invalid value for 'NAME|FILE'")


def test_completion_of_names():
    names = [item.value for item in METHOD.shell_complete(None, None, "cg5")]
    assert {"CG5a", "CG5(4)"} <= set(names)
    assert "CG4a" not in names
    assert [item.type for item in METHOD.shell_complete(None, None, "mine.t")] == ["file"]


def test_certify(run_command, tmp_path):
    file = tmp_path / "proof.toml"
    code, output, _ = run_command("certify", "CG3", "-o", str(file))
    assert (code, output[:24]) == (0, "CG3: order 3 is proved: ")
    assert cg.Certificate.load(file) == cg.certify("CG3")
    code, output, _ = run_command("certify", "CG6a", "--json")
    assert (code, json.loads(output)["proved"]) == (1, "no")
    code, output, _ = run_command("certify", "DICG4", "--json")
    assert (code, json.loads(output)["proved"]) == (0, "in part")
    assert json.loads(output)["message"] == str(cg.certify("DICG4"))
    code, output, _ = run_command("certify", "DICG4", "--complete")
    assert (code, output.splitlines()[0][:24]) == (1, "not proved: DICG4: no ze")


def test_certificates_are_proved_again(run_command, tmp_path):
    code, output, _ = run_command("certify", "--check", "CG3", "CG5a", "CG6a")
    assert code == 1
    assert [line[:24] for line in output.splitlines()] == [
        *("CG3: order 3 is proved: ", "CG5a: order 5 is proved ", "FAILED CG6a: CG6a has no"),
        "1 proved, 1 in part, 1 f",
    ]
    method = cg.Tableau([[], ["1/2"]], [0, 1], name="mine")
    cg.save(method, tmp_path / "mine.toml")
    proof = cg.certify(method)
    for order, code in ((2, 0), (3, 1)):
        replace(proof, order=order).save(tmp_path / "mine.certificate.toml")
        assert run_command("certify", "--check", str(tmp_path / "mine.toml"))[0] == code


def test_export(run_command, tmp_path):
    for format in ("json", "toml", "latex", "c", "python"):
        assert run_command("export", "CG3", format)[1].rstrip() == cg.export("CG3", format).rstrip()
    file = tmp_path / "cg3.h"
    assert run_command("export", "CG3", "c", "-o", str(file))[:2] == (0, "")
    assert file.read_text() == cg.export("CG3", "c")
    method = cg.methods["CG3(2)"].with_coefficients(cg.methods["CG3(2)"].coefficients, name="mine")
    certificate = cg.certify(method)
    cg.save(method, tmp_path / "mine.toml")
    certificate.save(tmp_path / "proof.toml")
    command = ["export", str(tmp_path / "mine.toml"), "json", "--digits", "50"]
    assert run_command(*command)[0] != 0
    _, text, _ = run_command(*command, "--certificate", str(tmp_path / "proof.toml"))
    assert json.loads(text)["b"] == cg.digits(method, 50, certificate=certificate)[1]
    code, _, error = run_command(*command, "--certificate", str(tmp_path / "mine.toml"))
    assert (code, "mine.toml" in error) == (2, True)


@pytest.mark.parametrize(("arguments", "named"), [
    (["show", "CG44a"], "NAME|FILE"),
    (["check", "cf5"], "similar names are CF5(4), CF5r, CF5e"),
    (["list", "--order", "0"], "--order"),
    (["list", "--kind", "x"], "--kind"),
    (["list", "--nonsense"], "--nonsense"),
    (["nonsense"], "no command is named 'nonsense'"),
    (["lst"], "no command is named 'lst'; similar names are list"),
    (["search", "--order", "3", "--stages", "3", "--store", "missing/x"], "store must be in an"),
    (["search", "--order", "6", "--stages", "3"], "pass --force"),
    (["export", "CG3", "cobol"], "FORMAT"),
    (["export", "DICG4", "c"], "format"),
    (["certify", "CG3", "-o", "/"], "--output"),
    (["certify", "CG3", "-o", "missing/x.toml"], "must be in an existing folder"),
    (["search", "--order", "2", "--stages", "2", "-o", "missing/x"], "existing folder"),
])  # fmt: skip
def test_bad_input_names_the_argument(run_command, arguments, named):
    code, output, error = run_command(*arguments)
    assert (code, output) == (2, "")
    assert error.startswith("crouch-grossman: error: ")
    assert error.count("\n") == 1
    assert named in error


def test_broken_files_are_named(run_command, tmp_path):
    file = tmp_path / "broken.toml"
    for content in ("a = [", "a = 1\nb = 2\n", "x = 1\n", "a = [[]]\nb = ['1e999999999']\n"):
        file.write_text(content)
        code, _, error = run_command("check", str(file))
        assert (code, str(file) in error, error.count("\n")) == (2, True, 1)
    file.write_bytes(b"\xff\xfe\xfa")
    assert run_command("check", str(file))[0] == 2
    error = run_command("show", str(tmp_path / "none.toml"))[2]
    assert error.endswith(f"{tmp_path / 'none.toml'}: No such file or directory\n")
    text = dumps(cg.methods["CG4a"].with_coefficients(cg.methods["CG4a"].coefficients))
    file.write_text(text.replace('"CG4a"', '"mine"'))
    error = run_command("export", str(file), "json", "--digits", "60")[2]
    assert "--certificate PROOF" in error
    assert "cg.certify" not in error


@pytest.mark.parametrize("command", [
    "certify CF3", "search --order 2 --stages 2 --starts 2", "construct --order 2 --stages 2"
])  # fmt: skip
def test_output_is_checked_first(run_command, command, tmp_path, monkeypatch):
    def never(*arguments, **options):
        raise AssertionError

    for module in (proving, searching):
        for name in ("certify", "search", "construct"):
            monkeypatch.setattr(module, name, never, raising=False)
    missing = tmp_path / "missing" / "x.toml"
    code, out, err = run_command(*command.split(), "-o", str(missing))
    assert (code, out) == (2, "")
    assert f"--output: {missing} must be in an existing folder" in err
    monkeypatch.undo()
    assert run_command(*command.split(), "-o", str(tmp_path / "x.toml"))[0] == 0
    assert list(tmp_path.rglob("*.toml"))
