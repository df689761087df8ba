"""The command, run in this process and in others: help, certify, export, errors."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace

import pytest

import cg
from cg.command import proving, searching

COMMANDS = ["certify", "check", "construct", "export", "list", "search", "show"]


def test_help_has_examples(run_command):
    code, output, _ = run_command()
    assert code == 0
    listed = re.findall(r"^  (\w+)  ", output.partition("Commands:")[2], re.MULTILINE)
    assert listed == COMMANDS
    for name in COMMANDS:
        code, output, _ = run_command(name, "--help")
        assert code == 0
        assert f"crouch-grossman {name}" in output.partition("Examples:")[2]
        assert ("--json" in output) == (name != "export")
    assert run_command("--version") == (0, f"crouch-grossman {cg.__version__}\n", "")


def test_module_is_the_command():
    command = [sys.executable, "-m", "cg", "show", "CG33"]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (completed.returncode, completed.stdout) == (2, "")
    assert completed.stderr.startswith("python -m cg: error: method must be the name of a method")
    closed = subprocess.getoutput(f'"{sys.executable}" -m cg list >&-')
    assert closed == "python -m cg: error: standard output must be open"


def test_certify(run_command, tmp_path):
    file = tmp_path / "proof.toml"
    code, output, _ = run_command("certify", "CG3", "-o", str(file))
    assert (code, output) == (0, f"{cg.certify('CG3')}\n")
    assert cg.Certificate.load(file) == cg.certify("CG3")
    assert run_command("certify", "CG3")[1].startswith(cg.certify("CG3").dumps())
    code, output, _ = run_command("certify", "CG6a", "--json")
    assert (code, json.loads(output)["proved"]) == (1, "no")
    code, output, _ = run_command("certify", "DICG4", "--json")
    statement = {"name": "DICG4", "proved": "in part", "message": str(cg.certify("DICG4"))}
    assert (code, json.loads(output)) == (0, statement)
    code, output, _ = run_command("certify", "DICG4", "--complete")
    assert (code, output[:24]) == (1, "not proved: DICG4: no ze")


def test_certificates_are_proved_again(run_command, tmp_path):
    code, output, _ = run_command("certify", "--check", "CG3", "CG5a", "CG6a")
    assert code == 1
    assert [line[:24] for line in output.splitlines()] == [
        *("CG3: order 3 is proved: ", "CG5a: order 5 is proved ", "not proved: CG6a has no "),
        "1 proved, 1 in part, 1 n",
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
    cg.save(method, tmp_path / "mine.toml")
    cg.certify(method).save(tmp_path / "proof.toml")
    command = ["export", str(tmp_path / "mine.toml"), "json", "--digits", "50"]
    assert run_command(*command)[0] == 2
    _, text, _ = run_command(*command, "--certificate", str(tmp_path / "proof.toml"))
    assert json.loads(text)["b"] == cg.digits("CG3(2)", 50)[1]


@pytest.mark.parametrize(("arguments", "named"), [
    ("show CG44a", "method must be the name of a method, got 'CG44a'"),
    ("check CFM6(4)", "method must be for nonlinear equations"),
    ("certify RKMK4", "method must not be a Munthe-Kaas method"),
    ("certify", "name one method, or pass --check"),
    ("certify --check --complete", "--check excludes --complete"),
    ("list --order 0", "--order"),
    ("export CG3 cobol", "'cobol' is not one of"),
    ("certify CG3 -o /", "--output"),
    (f"search --order 2 --stages 2 -o {__file__}", "is a file"),
    ("search --order 4", "Missing option '--stages', or '--tree'"),
    ("search --order 4 --tree DICG4", "--tree: <Tableau DICG4: "),
    ("search --order 4 --stages 5 --bound 1 --bound b=0:", "'--bound': give one number"),
    ("search --order 4 --stages 5 --bound b=0: --bound b=:1", "'--bound': give one number"),
    ("search --order 4 --stages 5 --hold x", "'--hold': give NAME=VALUE"),
    ("search --order 4 --stages 5 --hold b[2]=0 --hold b[2]=1", "'--hold': give NAME=VALUE"),
    ("construct --order 5 --stages 9 --first-stages 3", "first_stages must be at least 9"),
])  # fmt: skip
def test_errors_name_the_argument(run_command, arguments, named):
    code, output, error = run_command(*arguments.split())
    assert (code, output) == (2, "")
    assert error.startswith("crouch-grossman: error: ")
    assert error.count("\n") == 1
    assert named in error


def test_broken_files_are_named(run_command, tmp_path):
    file = tmp_path / "broken.toml"
    for content in (b"a = [", b"x = 1\n", b"a = [[]]\nb = ['1e999999999']\n", b"\xff\xfe\xfa"):
        file.write_bytes(content)
        for command in ("check", "show", "certify"):
            code, _, error = run_command(command, str(file))
            assert (code, str(file) in error, error.count("\n")) == (2, True, 1)
    code, _, error = run_command("export", "CG3", "json", "--certificate", str(file))
    assert (code, str(file) in error) == (2, True)


@pytest.mark.parametrize("command", [
    "certify {}", "export {} c", "export CG3 c --certificate {}",
    "search --order 2 --stages 2 --store {}", "construct --order 2 --stages 2 --store {}",
])  # fmt: skip
def test_output_is_checked_first(run_command, command, tmp_path, monkeypatch):
    def never(*arguments, **options):
        raise AssertionError

    monkeypatch.setattr(proving, "certify", never)
    monkeypatch.setattr(searching, "search", never)
    monkeypatch.setattr(searching, "construct", never)
    file, missing = tmp_path / "mine.toml", tmp_path / "missing" / "x.toml"
    file.write_text(text := cg.export("CG3", "toml"))
    for output in (file, os.path.relpath(file), missing):  # two would replace what is read
        code, out, err = run_command(*command.format(file).split(), "-o", str(output))
        assert (code, out, "--output" in err) == (2, "", True)
    assert f"--output: {missing} must be in an existing folder" in err
    assert file.read_text() == text
