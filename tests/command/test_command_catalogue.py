"""The subcommands list, show and check."""

import json

import pytest

import cg
from cg.construction.catalogue import loads


class TestList:
    def test_json(self, run_command):
        code, output, _ = run_command("list", "--json")
        every = json.loads(output)
        assert code == 0
        assert {m["name"] for m in every} == {*cg.methods}
        keys = [(m["order"], m["evaluations"], m["flows"]) for m in every]
        assert keys == sorted(keys)
        proved = {m["name"]: m["proved"] for m in every}
        assert (proved["CG4a"], proved["CF8a"], proved["CG6a"]) == ("yes", "in part", "no")
        assert proved["RKMK4"] == "classical"

    @pytest.mark.parametrize(("options", "selects"), [
        ("--order 5", lambda m: m["order"] == 5),
        ("--min-order 5", lambda m: m["order"] >= 5),
        ("--pair", lambda m: m["embedded_order"] is not None),
        ("--proved", lambda m: m["proved"] == "yes"),
        ("--kind implicit", lambda m: m["kind"] == "implicit"),
        ("--pair --kind magnus", lambda m: m["embedded_order"] and m["kind"] == "Magnus"),
    ])  # fmt: skip
    def test_filters(self, run_command, options, selects):
        every = json.loads(run_command("list", "--json")[1])
        selected = json.loads(run_command("list", "--json", *options.split())[1])
        assert selected == [m for m in every if selects(m)]
        assert 3 < len(selected) < len(every)

    def test_table(self, run_command):
        options = ("--order", "5", "--kind", "Crouch-Grossman", "--pair")
        heads, row = run_command("list", *options)[1].splitlines()
        assert heads.split() == [
            "name", "kind", "proved", "order", "evaluations", "flows", "error"
        ]  # fmt: skip
        error = f"{cg.methods['CG5(4)'].principal_error:.3g}"
        expected = ["CG5(4)", "Crouch-Grossman", "yes", "5(4)", "10", "55(64)", error]
        assert row.split() == expected

    def test_no_match_is_a_negative_result(self, run_command):
        message = "no method of the catalogue matches these options\n"
        assert run_command("list", "--order", "99") == (1, message, "")
        assert run_command("list", "--order", "99", "--json") == (1, "[]\n", "")


class TestShow:
    def test_text(self, run_command):
        code, output, _ = run_command("show", "CG2(3)")
        assert code == 0
        facts, _, tableau = output.partition("\n\n")
        assert ["embedded", "order", "2"] in [line.split() for line in facts.splitlines()]
        assert tableau.splitlines()[-1].split() == ["b^", "│", "17/54", "19/54", "1/3"]
        assert "└── point 3: -0.0833333 F1 + 0.75 F3; result" in run_command("show", "CF3")[1]
        assert "flow of the second result" in run_command("show", "CFM6(4)")[1]
        assert "drift  kick" in run_command("show", "Leapfrog")[1]

    @pytest.mark.parametrize("name", ["CG4a", "CF5(4)", "RKMK8(5,3)", "DICG3(2)", "CG6a", "CFM4"])
    def test_json_has_the_whole_method(self, run_command, name):
        method = cg.methods[name]
        data = json.loads(run_command("show", name, "--json")[1])
        assert loads(json.dumps(data["method"])) == method
        assert data["order"] == method.order
        assert data["source"] == method.source
        assert (data["certificate"] is None) == (name in {"CG6a", "RKMK8(5,3)"})

    def test_wrong_abscissae(self, run_command, tmp_path):
        """Only check accepts wrong abscissae, as a mistake."""
        file = tmp_path / "heun.toml"
        file.write_text('a = [[], [1]]\nb = ["1/2", "1/2"]\nc = [0, "1/2"]\n')
        code, _, error = run_command("show", str(file))
        assert (code, "row 2 of a sums to 1, not to c_2 = 1/2" in error) == (2, True)
        assert "mistake: row 2 of a sums to 1" in run_command("check", str(file))[1]


def test_check(run_command, tmp_path):
    assert run_command("check", "CG4a", "--order", "4") == (0, f"{cg.diagnose('CG4a')}\n", "")
    code, output, _ = run_command("check", "CG4a", "--order", "5")
    assert code == 1
    assert output.endswith("the order is 4, less than 5\n")
    file = tmp_path / "misprint.toml"
    cg.save(cg.Tableau([[], ["1/3"], [0, "2/5"]], ["1/4", 0, "3/4"]), file)
    code, output, _ = run_command("check", str(file), "--json")
    assert (code, json.loads(output)) == (1, cg.diagnose(str(file)).as_dict())
