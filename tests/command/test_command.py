"""The command, run in this process and in others."""

import json
import os
import re
import subprocess
import sys
from fractions import Fraction
from importlib.resources import files

import pytest
from watching import interrupted_search

import cg
from cg.catalogue import dumps, loads, magnus, munthe_kaas
from cg.catalogue.summary import compute_summary, summary_of
from cg.command import proving, searching
from cg.proofs import certificate_of

pytestmark = pytest.mark.no_core

COMMANDS = [
    "list", "show", "check", "search", "construct", "certify", "export", "plot", "runs",
    "reproduce", "completion"
]  # fmt: skip
SLIP = dumps(cg.methods["CG4a"]).replace(
    "-1.1092979392113465105841772499254356", "-1.1092979392113565"
)
QUICK = ["CG2(3)", "CG4a", "CG5a", "CF4b", "CF5(4)", "DP5(4)", "DICG4", "LieEuler", "RKMK5(4)"]


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
            assert ("--json" in output) == (name not in {"export", "plot", "runs", "completion"})

    def test_without_arguments(self, run):
        assert run() == run("--help")

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


class TestList:
    def test_filters_and_sorting(self, run):
        code, output, _ = run("list", "--json")
        every = json.loads(output)
        assert code == 0
        assert [m["name"] for m in every if m["kind"] != "Munthe-Kaas"] != sorted(cg.methods)
        assert {m["name"] for m in every} == {*cg.methods, *munthe_kaas, *magnus}
        assert [m["order"] for m in every] == sorted(m["order"] for m in every)
        proved = {m["name"]: m["proved"] for m in every}
        assert (proved["CG4a"], proved["CF8a"], proved["CG6a"]) == ("yes", "in part", "no")
        assert proved["RKMK4"] == "classical"
        _, output, _ = run(
            "list", "--json", "--min-order", "5", "--pair", "--max-flows", "20", "--sort", "flows"
        )
        entries = json.loads(output)
        expected = [
            m for m in every
            if m["order"] >= 5 and m["embedded_order"] is not None and m["flows"] <= 20
        ]  # fmt: skip
        assert len(entries) == len(expected) > 3
        assert [m["flows"] for m in entries] == sorted(m["flows"] for m in expected)
        _, output, _ = run("list", "--order", "4", "--no-pair", "--kind", "implicit", "--json")
        assert {m["name"] for m in json.loads(output)} == {"DICG4", "DICG4b"}

    def test_the_table(self, run):
        _, output, _ = run("list", "--order", "6", "--max-evaluations", "7", "--sort", "name")
        heads, *rows = [line.split() for line in output.splitlines()]
        assert heads == ["name", "kind", "proved", "order", "evaluations", "flows", "error"]
        assert [row[0] for row in rows] == ["CF6a", "CF6b", "CFM6(4)", "CFM6(4)b", "DICG6"]
        assert rows[1][2:6] == ["yes", "6", "7", "14"]
        options = ("--pair", "--kind", "commutator-free", "--json")
        lower = json.loads(run("list", "--min-order", "4", "--max-order", "5", *options)[1])
        assert [m["name"] for m in lower] == ["CF4(3)", "CF5(4)", "DP5(4)"]
        assert [m["flows"] for m in lower] != [m["pair_flows"] for m in lower]
        options = ("--pair", "--order", "5", "--kind", "Crouch-Grossman")
        (row,) = run("list", *options)[1].splitlines()[1:]
        method = cg.methods["CG5(4)"]
        assert row.split()[5] == f"{method.exponentials}({method.pair_exponentials})" == "55(64)"

    def test_proved_methods_only(self, run):
        every = json.loads(run("list", "--min-order", "6", "--json")[1])
        code, shown, _ = run("list", "--min-order", "6", "--proved")
        rows = [line.split() for line in shown.splitlines()[1:]]
        assert code == 0
        assert [row[0] for row in rows] == [m["name"] for m in every if m["proved"] == "yes"]
        assert 3 < len(rows) < len(every)

    def test_no_match_is_a_negative_result(self, run):
        message = "no method of the catalogue matches these options\n"
        assert run("list", "--order", "99") == (1, message, "")
        assert run("list", "--order", "99", "--json") == (1, "[]\n", "")

    @pytest.mark.parametrize("name", QUICK)
    def test_stored_facts_equal_computed(self, name):
        method = {**cg.methods, **munthe_kaas}[name]
        text = (files("cg.catalogue") / "summaries.json").read_text("utf-8")
        (stored,) = (entry for entry in json.loads(text) if entry["name"] == name)
        assert stored == summary_of(method).as_dict() == compute_summary(method).as_dict()

    @pytest.mark.parametrize(
        ("name", "counts", "error", "limits"),
        [
            ("LieEuler", (1, 1, 1), 0.5, (2.0, 0.0)),  # |1 + z|
            ("CF4", (4, 4, 5), 0.02252, (2.785, 2.828)),  # as all of order four with four stages
            ("DP5(4)", (5, 7, 12), 0.001885, (3.307, 0.9972)),  # as RK45 in flat space
        ],
    )
    def test_facts(self, name, counts, error, limits):
        facts = summary_of(cg.methods[name])
        assert (facts.order, facts.evaluations, facts.flows) == counts
        assert facts.principal_error == pytest.approx(error, rel=1e-3)
        assert (facts.real_stability, facts.imaginary_stability) == pytest.approx(limits, rel=1e-3)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", [*cg.methods, *munthe_kaas])
    def test_stored_facts_of_all(self, name):
        self.test_stored_facts_equal_computed(name)


class TestShow:
    def test_a_tableau(self, run):
        code, output, _ = run("show", "CG2(3)")
        lines = output.splitlines()
        assert code == 0
        assert lines[0] == "CG2(3), Crouch-Grossman"
        assert "  order                         3, of the second result 2" in lines
        assert lines[-5].split() == ["3/4", "│", "3/4"]
        assert lines[-2].split() == ["b", "│", "13/51", "-2/3", "24/17"]
        assert lines[-1].split() == ["b^", "│", "17/54", "19/54", "1/3"]

    def test_points(self, run):
        _, output, _ = run("show", "CF3", "--digits", "3")
        assert "│   └── point 3: -0.0833 F1 + 0.75 F3; result" in output

    def test_points_with_the_tableau_where_flows_commute(self, run):
        flat = run("show", "CF4")[1].partition("where flows commute:\n")[2].splitlines()
        assert [line.split("│")[0].strip() for line in flat if "│" in line][:4] == [
            "0", "1/2", "1/2", "1"
        ]  # fmt: skip
        assert flat[-1].split()[2:] == ["1/6", "1/3", "1/3", "1/6"]

    @pytest.mark.parametrize(("name", "count"), [("CG3", 22), ("RKMK4", 8)])
    def test_conditions(self, run, name, count):
        listed = json.loads(run("show", name, "--conditions", "4", "--json")[1])["conditions"]
        method = {**cg.methods, **munthe_kaas}[name]
        assert len(listed) == count == len(method.residuals(4))
        assert [one["residual"] for one in listed] == list(map(float, method.residuals(4)))
        for one in listed:
            tree = cg.trees.OrderedTree.parse(one["tree"])
            assert tree.nodes == one["order"] + (name == "CG3")
            if name == "CG3":
                assert one["right_side"] == str(Fraction(1, tree.density))
        shown = run("show", name, "--conditions", "4")[1].splitlines()
        assert shown[-count].split() == ["1", listed[0]["tree"], "1", "0"]

    def test_conditions_of_words(self, run):
        code, _, error = run("show", "CFM4", "--conditions", "2")
        assert (code, "--conditions: CFM4 has conditions of words" in error) == (2, True)

    @pytest.mark.parametrize("name", ["CG4a", "CF5(4)"])
    def test_digits_beyond_the_stored_ones(self, run, name):
        method = cg.methods[name]
        code, shown, _ = run("show", name, "--digits", "60")
        assert code == 0
        texts = (
            [x for row in method.digits(60)[0] for x in row]
            if name == "CG4a"
            else [x.lstrip("-") for row in method.digits(60) for x in row.values()]
        )
        assert max(map(len, texts)) > 60
        assert all(text in shown for text in texts if text != "0")

    def test_stored_digits(self, run):
        shown = run("show", "CG4a", "--digits", "30")[1]
        assert "0.817722798812485183864383415847" in shown  # not those of a double

    def test_digits_that_nothing_proves(self, run):
        code, shown, error = run("show", "CF8a", "--digits", "60")
        assert (code, shown) == (2, "")
        assert "digits must be at most 34, which are stored" in error
        assert run("show", "CG6a")[0] == 0

    def test_proof_in_part(self, run):
        """The command words a proof as the certificate does."""
        (line,) = [x for x in run("show", "CF8a")[1].splitlines() if "certificate" in x]
        certificate = certificate_of(cg.methods["CF8a"])
        assert line.split(maxsplit=1)[1] == str(certificate)
        assert "order 8 is proved in part: coefficients within 1.7e-35 of the stored ones" in line
        assert certificate.statement in str(certificate)

    @pytest.mark.parametrize("name", ["CG4a", "CF5(4)", "RKMK8(5,3)", "DICG3(2)", "CG6a"])
    def test_json_has_the_whole_method(self, run, name):
        method = {**cg.methods, **munthe_kaas}[name]
        data = json.loads(run("show", name, "--json")[1])
        assert loads(json.dumps(data["method"])) == method
        assert data["order"] == method.order
        assert data["source"] == method.source
        assert (data["certificate"] is None) == (name in {"CG6a", "RKMK8(5,3)"})

    def test_files_written_by_hand(self, run, tmp_path):
        """All commands read what check reads, and a method without name has that of its file."""
        file = tmp_path / "heun.toml"
        file.write_text('a = [[], [1]]\nb = ["1/2", "1/2"]\nc = [0, 1]\n')
        for command in ("show", "check", "certify"):
            code, output, _ = run(command, str(file))
            assert (code, "heun" in output) == (0, True)
        cg.Tableau([[], [1]], ["1/2", "1/2"]).save(file)
        assert cg.Method.load(file).name == "heun"
        file.write_text('a = [[], [1]]\nb = ["1/2", "1/2"]\nc = [0, "1/2"]\n')
        code, _, error = run("show", str(file))
        assert (code, "row 2 of a sums to 1, not to c_2 = 1/2" in error) == (2, True)
        assert "mistake: row 2 of a sums to 1" in run("check", str(file))[1]

    def test_a_file(self, run, tmp_path):
        file = tmp_path / "mine.toml"
        file.write_text(dumps(cg.Tableau([[], [1]], ["1/2", "1/2"], name="Heun")))
        code, output, _ = run("show", str(file))
        assert (code, output.splitlines()[0]) == (0, "Heun, Crouch-Grossman")


class TestCheck:
    def test_magnus_methods_are_rejected_in_a_line(self, run):
        code, output, error = run("check", "CFM6(4)")
        assert (code, output) == (2, "")
        assert "method must be for nonlinear equations" in error
        assert len(error.splitlines()) == 1

    def test_a_method_without_mistake(self, run):
        code, output, _ = run("check", "CG4a", "--order", "4")
        assert code == 0
        assert "order: 4 on manifolds" in output
        assert "    └── ●\n        └── ●\n" in output

    def test_order_too_low(self, run):
        code, output, _ = run("check", "CG4a", "--order", "5")
        assert code == 1
        assert output.endswith("the order is 4, less than 5\n")

    @pytest.mark.parametrize("suffix", ["toml", "json"])
    def test_misprint_of_cg4a(self, run, tmp_path, suffix):
        file = tmp_path / f"mine.{suffix}"
        text = SLIP if suffix == "toml" else loads(SLIP).export("json")
        file.write_text(text)
        code, output, _ = run("check", str(file))
        assert code == 1
        assert "mistake: it is CG4a with a misprint" in output
        code, output, _ = run("check", str(file), "--json")
        assert code == 1
        assert [f["kind"] for f in json.loads(output)["findings"]] == ["slip"]


class TestNewMethods:
    def test_search(self, run, tmp_path):
        arguments = ("search", "--order", "3", "--stages", "3", "--starts", "8", "--seed", "1")
        code, output, _ = run(*arguments, "--json", "-o", str(tmp_path / "found"))
        methods = [loads(json.dumps(entry)) for entry in json.loads(output)]
        assert code == 0
        assert methods == sorted(methods, key=lambda m: max(abs(m.a).max(), abs(m.b).max()))
        assert set(methods) == set(cg.search(3, 3, 8, 1).methods)
        saved = [cg.catalogue.load(path) for path in (tmp_path / "found").iterdir()]
        assert set(saved) == set(methods)

    def test_no_method_found(self, run):
        arguments = ("search", "--order", "4", "--stages", "4", "--starts", "1", "--force")
        assert run(*arguments)[:2] == (1, "no method found\n")

    def test_construct(self, run):
        code, output, _ = run("construct", "--order", "3", "--stages", "3")
        assert code == 0
        assert loads(output) == cg.construct(3, 3, 0).method

    def test_certify(self, run, tmp_path):
        file = tmp_path / "proof.toml"
        code, output, _ = run("certify", "CG3", "-o", str(file))
        assert (code, output[:24]) == (0, "CG3: order 3 is proved: ")
        assert cg.Certificate.load(file) == cg.certify("CG3")
        code, output, _ = run("certify", "CG6a", "--json")
        assert (code, json.loads(output)["proved"]) == (1, "no")

    def test_certify_small(self, run):
        code, output, _ = run("certify", "CF5c", "--small", "--json")
        assert (code, json.loads(output)["proved"]) == (0, "in part")
        assert json.loads(output)["message"] == str(cg.certify("CF5c", small=True))


class TestExport:
    def test_every_format(self, run, tmp_path):
        for format in ("json", "toml", "latex", "c", "python"):
            assert run("export", "CG3", format)[1].rstrip() == cg.export("CG3", format).rstrip()
        file = tmp_path / "cg3.h"
        assert run("export", "CG3", "c", "-o", str(file))[:2] == (0, "")
        assert file.read_text() == cg.export("CG3", "c")

    def test_digits(self, run):
        text = run("export", "CG4a", "json", "--digits", "50")[1]
        assert json.loads(text) == json.loads(cg.export("CG4a", "json", digits=50))

    def test_certificate(self, run, tmp_path):
        method = cg.methods["CG3(2)"].with_coefficients(
            cg.methods["CG3(2)"].coefficients, name="mine"
        )
        certificate = cg.certify(method)
        method.save(tmp_path / "mine.toml")
        certificate.save(tmp_path / "proof.toml")
        command = ["export", str(tmp_path / "mine.toml"), "json", "--digits", "50"]
        assert run(*command)[0] != 0
        _, text, _ = run(*command, "--certificate", str(tmp_path / "proof.toml"))
        assert json.loads(text)["b"] == method.digits(50, certificate=certificate)[1]
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


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["show", "CG44a"], "NAME|FILE"),
        (["show", "missing.toml"], "NAME|FILE"),
        (["check", "cf5"], "similar names are CF5(4), CF5r, CF5e"),
        (["list", "--order", "x"], "--order"),
        (["list", "--order", "0"], "--order"),
        (["list", "--kind", "x"], "--kind"),
        (["list", "--nonsense"], "--nonsense"),
        (["nonsense"], "nonsense"),
        (["search", "--order", "3"], "--stages"),
        (["search", "--order", "6", "--stages", "3"], "pass --force"),
        (["search", "--order", "99", "--stages", "3"], "order"),
        (["export", "CG3", "cobol"], "FORMAT"),
        (["export", "DICG4", "c"], "format"),
        (["certify", "CG3", "-o", "/"], "--output"),
        (["certify", "CG3", "-o", "missing/x.toml"], "must be in an existing folder"),
        (["export", "CG3", "c", "-o", "missing/x.h"], "must be in an existing folder"),
        (["plot", "CG3", "points", "-o", "missing/x.svg"], "must be in an existing folder"),
        (["construct", "--order", "2", "--stages", "2", "-o", "missing/x.toml"], "existing folder"),
        (["search", "--order", "2", "--stages", "2", "-o", "missing/x"], "existing folder"),
    ],
)
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


@pytest.mark.parametrize(
    "arguments",
    [
        ("certify", "CF3", "-o", "{}/x.toml"),
        ("search", "--order", "2", "--stages", "2", "--starts", "2", "-o", "{}/x.toml"),
        ("construct", "--order", "2", "--stages", "2", "-o", "{}/x.toml"),
    ],
)
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
    error = run("runs", "list", str(tmp_path / "none" / "runs.db"))[2]
    assert "Errno" not in error
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*none/x.toml'$"):
        cg.methods["CG3"].save(tmp_path / "none" / "x.toml")


def test_publish_checks_folder_first(run, tmp_path):
    store = tmp_path / "runs.db"
    run("search", "--order", "2", "--stages", "2", "--starts", "2", "--store", str(store))
    code, _, err = run("runs", "publish", str(store), "1", "Mine", "--folder", "/proc")
    assert code == 2
    assert "--folder: /proc/Mine can't be written" in err


def test_certify_rejects_munthe_kaas(run):
    code, out, err = run("certify", "RKMK4")
    assert (code, out) == (2, "")
    assert (
        "NAME|FILE: method must not be a Munthe-Kaas method, whose order is that of its tableau"
        in err
    )


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

    def test_interrupt(self, tmp_path):
        file = tmp_path / "runs"
        command = [sys.executable, "-m", "cg", "search", "--order", "5", "--stages", "9",
                   "--starts", "100000", "--store", str(file)]  # fmt: skip
        code, error = interrupted_search(command, file)
        assert code == 130
        assert error.endswith(
            f"python -m cg: interrupted; finished results are in {file}; run the same search again "
            "to continue, on any executor\n"
        )

    def test_completion_of_names(self):
        words = {"COMP_WORDS": "crouch-grossman show CG5", "COMP_CWORD": "2"}
        request = {"_CROUCH_GROSSMAN_COMPLETE": "bash_complete"}
        completed = process(env={**os.environ, **words, **request})
        names = {line.partition(",")[2] for line in completed.stdout.splitlines()}
        assert {"CG5a", "CG5(4)"} <= names
        assert "CG4a" not in names

    @pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
    def test_completion_script(self, run, shell):
        code, output, _ = run("completion", shell)
        assert code == 0
        assert "_CROUCH_GROSSMAN_COMPLETE" in output
