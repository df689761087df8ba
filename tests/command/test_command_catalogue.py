"""The subcommands list, show and check."""

import json
from dataclasses import asdict
from fractions import Fraction
from importlib.resources import files

import pytest
from kinds import FROZEN, MUNTHE_KAAS

import cg
from cg.construction.catalogue import dumps, loads
from cg.construction.catalogue.summary import compute_summary, summary_of

SLIP = dumps(cg.methods["CG4a"]).replace(
    "-1.1092979392113465105841772499254356", "-1.1092979392113565"
)
QUICK = ["CG2(3)", "CG4a", "CG5a", "CF4b", "CF5(4)", "DP5(4)", "DICG4", "LieEuler", "RKMK5(4)"]


class TestList:
    def test_filters_and_sorting(self, run_command):
        code, output, _ = run_command("list", "--json")
        every = json.loads(output)
        assert code == 0
        assert {m["name"] for m in every} == {*cg.methods}
        assert [m["order"] for m in every] == sorted(m["order"] for m in every)
        proved = {m["name"]: m["proved"] for m in every}
        assert (proved["CG4a"], proved["CF8a"], proved["CG6a"]) == ("yes", "in part", "no")
        assert proved["RKMK4"] == "classical"
        _, output, _ = run_command(
            "list", "--json", "--min-order", "5", "--pair", "--sort", "flows"
        )
        entries = json.loads(output)
        expected = [m for m in every if m["order"] >= 5 and m["embedded_order"] is not None]
        assert len(entries) == len(expected) > 3
        assert [m["flows"] for m in entries] == sorted(m["flows"] for m in expected)
        _, output, _ = run_command(
            "list", "--order", "4", "--no-pair", "--kind", "implicit", "--json"
        )
        assert {m["name"] for m in json.loads(output)} == {"DICG4", "DICG4b", "DICG4c"}

    def test_the_table(self, run_command):
        _, output, _ = run_command(
            "list", "--order", "6", "--no-pair", "--kind", "commutator-free", "--sort", "name"
        )
        heads, *rows = [line.split() for line in output.splitlines()]
        assert heads == ["name", "kind", "proved", "order", "evaluations", "flows", "error"]
        assert [row[0] for row in rows] == ["CF6a", "CF6b", "CF6c", "CF6d"]
        assert rows[1][2:6] == ["yes", "6", "7", "14"]
        options = ("--pair", "--kind", "commutator-free", "--json")
        lower = json.loads(run_command("list", "--min-order", "4", *options)[1])
        assert [m["name"] for m in lower][:4] == ["CF4(3)", "CF4(3)r", "CF5(4)", "DP5(4)"]
        assert [m["flows"] for m in lower] != [m["pair_flows"] for m in lower]
        options = ("--pair", "--order", "5", "--kind", "Crouch-Grossman")
        (row,) = run_command("list", *options)[1].splitlines()[1:]
        method = cg.methods["CG5(4)"]
        assert row.split()[5] == f"{method.exponentials}({method.pair_exponentials})" == "55(64)"

    def test_no_match_is_a_negative_result(self, run_command):
        message = "no method of the catalogue matches these options\n"
        assert run_command("list", "--order", "99") == (1, message, "")
        assert run_command("list", "--order", "99", "--json") == (1, "[]\n", "")

    @pytest.mark.parametrize("name", QUICK)
    def test_stored_facts_equal_computed(self, name):
        method = cg.methods.read_again(name)
        text = (files("cg.construction.catalogue") / "summaries.json").read_text("utf-8")
        (stored,) = (entry for entry in json.loads(text) if entry["name"] == name)
        assert stored == asdict(summary_of(method)) == asdict(compute_summary(method))

    @pytest.mark.slow
    def test_stored_orders_equal_computed(self, tmp_path):
        for name, method in cg.methods.items():
            again = cg.methods.read_again(name)
            assert again.exact_order == method.exact_order, name
            assert again.embedded_order == method.embedded_order, name
        text = cg.construction.catalogue.dumps(cg.methods["CG3"]).replace('"CG3"', '"CG5a"')
        (tmp_path / "CG5a.toml").write_text(text, encoding="utf-8")
        mine = cg.construction.catalogue.Catalogue(tmp_path)["CG5a"]
        assert mine.order == 3  # not that of the package's CG5a

    @pytest.mark.slow
    @pytest.mark.parametrize("name", {**FROZEN, **MUNTHE_KAAS})
    def test_stored_facts_of_all(self, name):
        self.test_stored_facts_equal_computed(name)

    def test_proved_methods_only(self, run_command):
        every = json.loads(run_command("list", "--min-order", "6", "--json")[1])
        code, shown, _ = run_command("list", "--min-order", "6", "--proved")
        rows = [line.split() for line in shown.splitlines()[1:]]
        assert code == 0
        assert [row[0] for row in rows] == [m["name"] for m in every if m["proved"] == "yes"]
        assert 3 < len(rows) < len(every)


class TestShow:
    def test_a_tableau(self, run_command):
        code, output, _ = run_command("show", "CG2(3)")
        lines = output.splitlines()
        assert code == 0
        assert lines[0] == "CG2(3), Crouch-Grossman"
        assert "  order                         3, of the second result 2" in lines
        assert lines[-5].split() == ["3/4", "│", "3/4"]
        assert lines[-2].split() == ["b", "│", "13/51", "-2/3", "24/17"]
        assert lines[-1].split() == ["b^", "│", "17/54", "19/54", "1/3"]

    def test_points(self, run_command):
        _, output, _ = run_command("show", "CF3", "--digits", "3")
        assert "│   └── point 3: -0.0833 F1 + 0.75 F3; result" in output

    @pytest.mark.parametrize(("name", "count"), [("CG3", 22), ("RKMK4", 8)])
    def test_conditions(self, run_command, name, count):
        listed = json.loads(run_command("show", name, "--conditions", "4", "--json")[1])[
            "conditions"
        ]
        method = cg.methods[name]
        assert len(listed) == count == len(method.residuals(4))
        assert [one["residual"] for one in listed] == list(map(float, method.residuals(4)))
        for one in listed:
            tree = cg.construction.trees.OrderedTree.parse(one["tree"])
            assert tree.nodes == one["order"] + (name == "CG3")
            if name == "CG3":
                assert one["right_side"] == str(Fraction(1, tree.density))
        shown = run_command("show", name, "--conditions", "4")[1].splitlines()
        assert shown[-count].split() == ["1", listed[0]["tree"], "1", "0"]

    @pytest.mark.parametrize("name", ["CG4a", "CF5(4)"])
    def test_digits_beyond_the_stored_ones(self, run_command, name):
        method = cg.methods[name]
        code, shown, _ = run_command("show", name, "--digits", "60")
        assert code == 0
        texts = (
            [x for row in cg.digits(method, 60)[0] for x in row]
            if name == "CG4a"
            else [x.lstrip("-") for row in cg.digits(method, 60) for x in row.values()]
        )
        assert max(map(len, texts)) > 60
        assert all(text in shown for text in texts if text != "0")
        stored = run_command("show", "CG4a", "--digits", "30")[1]
        assert "0.817722798812485183864383415847" in stored  # not those of a double

    def test_what_a_method_has_not(self, run_command):
        code, _, error = run_command("show", "CFM4", "--conditions", "2")
        assert (code, "--conditions: CFM4 has conditions of words" in error) == (2, True)
        code, shown, error = run_command("show", "CF8a", "--digits", "160")
        assert (code, shown) == (2, "")
        assert "digits must be at most 150" in error
        assert run_command("show", "CG6a")[0] == 0

    @pytest.mark.parametrize("name", ["CG4a", "CF5(4)", "RKMK8(5,3)", "DICG3(2)", "CG6a"])
    def test_json_has_the_whole_method(self, run_command, name):
        method = cg.methods[name]
        data = json.loads(run_command("show", name, "--json")[1])
        assert loads(json.dumps(data["method"])) == method
        assert data["order"] == method.order
        assert data["source"] == method.source
        assert (data["certificate"] is None) == (name in {"CG6a", "RKMK8(5,3)"})

    def test_files_written_by_hand(self, run_command, tmp_path):
        """All commands read what check reads, and a method without name has that of its file."""
        file = tmp_path / "heun.toml"
        file.write_text('a = [[], [1]]\nb = ["1/2", "1/2"]\nc = [0, 1]\n')
        for command in ("show", "check", "certify"):
            code, output, _ = run_command(command, str(file))
            assert (code, "heun" in output) == (0, True)
        cg.save(cg.Tableau([[], [1]], ["1/2", "1/2"]), file)
        assert cg.load(file).name == "heun"
        file.write_text('a = [[], [1]]\nb = ["1/2", "1/2"]\nc = [0, "1/2"]\n')
        code, _, error = run_command("show", str(file))
        assert (code, "row 2 of a sums to 1, not to c_2 = 1/2" in error) == (2, True)
        assert "mistake: row 2 of a sums to 1" in run_command("check", str(file))[1]


def test_check(run_command, tmp_path):
    code, output, error = run_command("check", "CFM6(4)")
    assert (code, output, error.count("\n")) == (2, "", 1)
    assert "method must be for nonlinear equations" in error
    code, output, _ = run_command("check", "CG4a", "--order", "4")
    assert code == 0
    assert "order: 4 on manifolds" in output
    assert "    └── ●\n        └── ●\n" in output
    code, output, _ = run_command("check", "CG4a", "--order", "5")
    assert code == 1
    assert output.endswith("the order is 4, less than 5\n")
    for file in (tmp_path / "mine.toml", tmp_path / "mine.json"):
        file.write_text(SLIP if file.suffix == ".toml" else cg.export(loads(SLIP), "json"))
        code, output, _ = run_command("check", str(file))
        assert code == 1
        assert "if only a_5,4 = -1.1092979392113565 were -1.10929793921134651058" in output
        code, output, _ = run_command("check", str(file), "--json")
        assert code == 1
        assert [one["name"] for one in json.loads(output)["corrections"]] == ["a_5,4"]
