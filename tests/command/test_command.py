"""The command, run in this process and in others."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

import cg
from cg.command import proving, searching
from cg.construction.catalogue import dumps, loads

COMMANDS = [
    "list", "show", "check", "search", "construct", "certify", "export", "plot",
    "reproduce", "completion"
]  # fmt: skip


@pytest.fixture
def run(run_command):
    return run_command


def process(*arguments, **options):
    command = [sys.executable, "-m", "cg", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


class TestHelp:
    def test_help_has_examples(self, run):
        code, output, _ = run("--help")
        assert code == 0
        listed = re.findall(r"^  (\w+)  ", output.partition("Commands:")[2], re.MULTILINE)
        assert listed == COMMANDS
        for name in set(COMMANDS) - {"reproduce"}:
            code, output, _ = run(name, "--help")
            assert code == 0
            assert f"crouch-grossman {name}" in output.partition("Examples:")[2]
            assert ("--json" in output) == (name not in {"export", "plot", "completion"})

    def test_version(self, run):
        assert run("--version") == (0, f"crouch-grossman {cg.__version__}\n", "")

    def test_commands_are_imported_lazily(self):
        code = "import sys, cg.command; cg.command.main(['--version'])\nprint(*sys.modules)"
        process = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        loaded = set(process.stdout.split())
        assert "click" in loaded
        assert not {"numpy", "scipy", "flint", "cg.command.searching"} & loaded


class TestNewMethods:
    def test_search(self, run, tmp_path):
        arguments = ("search", "--order", "3", "--stages", "3", "--starts", "8", "--seed", "1")
        code, output, _ = run(*arguments, "--json", "-o", str(tmp_path / "found"))
        methods = [loads(json.dumps(entry)) for entry in json.loads(output)]
        assert code == 0
        assert methods == sorted(methods, key=lambda m: max(abs(m.a).max(), abs(m.b).max()))
        assert set(methods) == set(cg.search(3, 3, 8, 1).methods)
        saved = [cg.construction.catalogue.load(path) for path in (tmp_path / "found").iterdir()]
        assert set(saved) == set(methods)

    def test_no_method_found(self, run):
        arguments = ("search", "--order", "4", "--stages", "4", "--starts", "1", "--force")
        assert run(*arguments)[:2] == (1, "no method found\n")

    def test_certify(self, run, tmp_path):
        file = tmp_path / "proof.toml"
        code, output, _ = run("certify", "CG3", "-o", str(file))
        assert (code, output[:24]) == (0, "CG3: order 3 is proved: ")
        assert cg.Certificate.load(file) == cg.certify("CG3")
        code, output, _ = run("certify", "CG6a", "--json")
        assert (code, json.loads(output)["proved"]) == (1, "no")

    def test_certify_in_part(self, run):
        code, output, _ = run("certify", "DICG4", "--json")
        assert (code, json.loads(output)["proved"]) == (0, "in part")
        assert json.loads(output)["message"] == str(cg.certify("DICG4"))
        code, output, _ = run("certify", "DICG4", "--complete")
        assert (code, output.splitlines()[0][:24]) == (1, "not proved: DICG4: no ze")

    def test_certificates_are_proved_again(self, run, tmp_path):
        code, output, _ = run("certify", "--check", "CG3", "CG5a", "CG6a")
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
            assert run("certify", "--check", str(tmp_path / "mine.toml"))[0] == code


class TestExport:
    def test_every_format(self, run, tmp_path):
        for format in ("json", "toml", "latex", "c", "python"):
            assert run("export", "CG3", format)[1].rstrip() == cg.export("CG3", format).rstrip()
        file = tmp_path / "cg3.h"
        assert run("export", "CG3", "c", "-o", str(file))[:2] == (0, "")
        assert file.read_text() == cg.export("CG3", "c")

    def test_certificate(self, run, tmp_path):
        method = cg.methods["CG3(2)"].with_coefficients(
            cg.methods["CG3(2)"].coefficients, name="mine"
        )
        certificate = cg.certify(method)
        cg.save(method, tmp_path / "mine.toml")
        certificate.save(tmp_path / "proof.toml")
        command = ["export", str(tmp_path / "mine.toml"), "json", "--digits", "50"]
        assert run(*command)[0] != 0
        _, text, _ = run(*command, "--certificate", str(tmp_path / "proof.toml"))
        assert json.loads(text)["b"] == cg.digits(method, 50, certificate=certificate)[1]
        code, _, error = run(*command, "--certificate", str(tmp_path / "mine.toml"))
        assert code != 0
        assert "mine.toml" in error


class TestPlot:
    @pytest.mark.parametrize("what", ["points", "tableau", "stability"])
    def test_pictures(self, run, tmp_path, what):
        file = tmp_path / "method.svg"
        assert run("plot", "CG3", what, "-o", str(file)) == (0, "", "")
        assert "<svg" in file.read_text()

    def test_unknown_kinds_of_files(self, run, tmp_path):
        code, _, error = run("plot", "CG3", "points", "-o", str(tmp_path / "method.nonsense"))
        assert (code, "nonsense" in error) == (2, True)


@pytest.mark.parametrize(("arguments", "named"), [
    (["show", "CG44a"], "NAME|FILE"),
    (["check", "cf5"], "similar names are CF5(4), CF5r, CF5e"),
    (["list", "--order", "0"], "--order"),
    (["list", "--kind", "x"], "--kind"),
    (["list", "--nonsense"], "--nonsense"),
    (["nonsense"], "nonsense"),
    (["search", "--order", "3"], "--stages"),
    (["search", "--order", "6", "--stages", "3"], "pass --force"),
    (["export", "CG3", "cobol"], "FORMAT"),
    (["export", "DICG4", "c"], "format"),
    (["certify", "CG3", "-o", "/"], "--output"),
    (["certify", "CG3", "-o", "missing/x.toml"], "must be in an existing folder"),
    (["search", "--order", "2", "--stages", "2", "-o", "missing/x"], "existing folder"),
])  # fmt: skip
def test_bad_input_names_the_argument(run, arguments, named):
    code, output, error = run(*arguments)
    assert (code, output) == (2, "")
    assert error.startswith("crouch-grossman: error: ")
    assert error.count("\n") == 1
    assert named in error


def test_broken_files_are_named(run, tmp_path):
    file = tmp_path / "broken.toml"
    for content in ("a = [", "a = 1\nb = 2\n", "x = 1\n", "a = [[]]\nb = ['1e999999999']\n"):
        file.write_text(content)
        code, _, error = run("check", str(file))
        assert (code, str(file) in error, error.count("\n")) == (2, True, 1)
    file.write_bytes(b"\xff\xfe\xfa")
    assert run("check", str(file))[0] == 2


@pytest.mark.parametrize("arguments", [
    ("certify", "CF3", "-o", "{}/x.toml"),
    ("search", "--order", "2", "--stages", "2", "--starts", "2", "-o", "{}/x.toml"),
    ("construct", "--order", "2", "--stages", "2", "-o", "{}/x.toml"),
])  # fmt: skip
def test_output_is_checked_first(run, arguments, tmp_path, monkeypatch):
    """No user can write to a folder of the kernel."""

    def never(*arguments, **options):
        raise AssertionError

    for module in (proving, searching):
        for name in ("certify", "search", "construct"):
            monkeypatch.setattr(module, name, never, raising=False)
    code, out, err = run(*(word.format("/proc") for word in arguments))
    assert (code, out) == (2, "")
    assert "--output: /proc/" in err
    monkeypatch.undo()
    assert run(*(word.format(tmp_path) for word in arguments))[0] == 0
    assert list(tmp_path.rglob("*.toml"))


def test_messages_name_options_and_files(run, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(dumps(cg.methods["CG4a"].with_coefficients(cg.methods["CG4a"].coefficients)))
    file.write_text(file.read_text().replace('"CG4a"', '"mine"'))
    error = run("export", str(file), "json", "--digits", "60")[2]
    assert "--certificate PROOF" in error
    assert "cg.certify" not in error
    for command in ("certify", "check", "show", "plot"):
        error = run(command, str(tmp_path / "none.toml"))[2]
        assert error.endswith(f"{tmp_path / 'none.toml'}: No such file or directory\n")
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*none/x.toml'$"):
        cg.save(cg.methods["CG3"], tmp_path / "none" / "x.toml")


def test_reproduce_takes_the_options_of_reproduce_paper(run):
    code, output, _ = run("reproduce", "--list")
    assert code == 0
    assert "table3.2" in [line.split()[0] for line in output.splitlines()]
    assert run("reproduce", "--help")[0] == 0
    assert run("reproduce", "--seed", "x")[0] == 2


class TestProcess:
    def test_module(self):
        completed = process("show", "CG3")
        assert (completed.returncode, completed.stderr) == (0, "")
        assert completed.stdout.startswith("CG3, Crouch-Grossman")
        completed = process("show", "CG33")
        assert (completed.returncode, completed.stdout) == (2, "")
        assert completed.stderr.startswith("python -m cg: error: Invalid value for 'NAME|FILE'")

    def test_completion_of_names(self):
        words = {"COMP_WORDS": "crouch-grossman show CG5", "COMP_CWORD": "2"}
        request = {"_CROUCH_GROSSMAN_COMPLETE": "bash_complete"}
        completed = process(env={**os.environ, **words, **request})
        names = {line.partition(",")[2] for line in completed.stdout.splitlines()}
        assert {"CG5a", "CG5(4)"} <= names
        assert "CG4a" not in names

    @pytest.mark.skipif(shutil.which("bash") is None, reason="bash isn't installed")
    def test_completion_in_bash(self, run, tmp_path):
        """Keys and the arguments that bash gets, quoted as it needs them."""
        typed = {
            "show RKMK5\t": "<show><RKMK5(4)>",
            r"show CFM8\(" + "\t": "<show><CFM8(4)>",
            'show "CFM8(\t': "<show><CFM8(4)>",
            "show cfm6\tb": "<show><CFM6(4)b>",  # what is common to two
            "show dvmi\t": "<show><dvmine (1).toml>",
            "show DVERK6\t": "<show><DVERK6(5)>",
            "show DVERK8\t": "<show><DVERK8.toml>",
            "comp\tb\t": "<completion><bash>",
        }
        for name in ("dvmine (1).toml", "DVERK8.toml"):
            (tmp_path / name).touch()
        (tmp_path / "completion").mkdir()  # not what is meant by a command
        program = tmp_path / "bin" / "crouch-grossman"
        program.parent.mkdir()
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cg "$@"\n')
        program.chmod(0o755)
        path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
        environment = {**os.environ, "PATH": path, "HISTFILE": "", "INPUTRC": "/dev/null"}
        lines = [run("completion", "bash")[1], "crouch-grossman() { printf '<%s>' \"$@\"; echo; }"]
        lines += [f"crouch-grossman {keys}" for keys in typed]
        printed = subprocess.check_output(
            ["bash", "--norc", "--noprofile", "-i"], text=True, stderr=subprocess.DEVNULL,
            input="\n".join([*lines, ""]), env=environment, cwd=tmp_path,
        )  # fmt: skip
        assert printed.splitlines() == [*typed.values()]

    @pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
    def test_completion_script(self, run, shell):
        code, output, _ = run("completion", shell)
        assert code == 0
        assert "_CROUCH_GROSSMAN_COMPLETE" in output
