from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from refusals import refuses
from report_pages import check_page, context, read

from cg.construction.catalogue import methods
from cg.reproduce import report
from cg.reproduce import run as run_module
from cg.reproduce.blocks import Settings, number
from cg.reproduce.coefficients import fixed, labels, method_data
from cg.reproduce.main import main
from cg.reproduce.quad_orders import order_data
from cg.reproduce.report import page
from cg.reproduce.sections import fig4_2_quad, search, table3_2
from cg.reproduce.sections.claims import CLAIMS, NEEDS, VERDICTS
from cg.support.quads import to_decimal


def test_needed_items_run_first():
    chosen = [item.name for item in report.select(["claims"])]
    assert chosen[-1] == "claims"
    assert set(NEEDS) < set(chosen)
    assert [item.name for item in report.select(["fig4.1"])] == ["fig4.1"]


def test_table_end_to_end(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["--only", "table3.2", "--out", str(out)]) == 0
    assert "Table of Section 3.2" in capsys.readouterr().err
    results = read(out)
    assert list(results["items"]) == ["table3.2"]
    assert results["settings"] == {"seed": 0, "full": False}
    rows = results["items"]["table3.2"]["rows"]
    assert [row["computed"] for row in rows] == [dict(row) for row in table3_2.PAPER]
    assert [(row["trees"], row["discarded"]) for row in rows] == [(22, 9), (64, 26), (196, 83)]
    text = (out / "report.html").read_text("utf-8")
    check_page(text)
    assert all(f">{n}</td>" in text for n in (13, 38, 113, 8, 17, 37, 15, 45, 136))


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """Two runs into different folders, the second of some items of the first."""
    folders = [tmp_path_factory.mktemp("figures") for _ in range(2)]
    for folder, names in zip(folders, ("fig4.1,fig4.2,appendix,table3.2", "fig4.1"), strict=True):
        assert main([f"--only={names}", "--out", str(folder)]) == 0
    return folders


def test_figures_exist_and_their_page_is_self_contained(figures):
    folder = figures[0] / "figures"
    names = {f"fig{n}-{reading}" for n in ("4.1", "4.2") for reading in ("momentum", "velocity")}
    assert {path.name for path in folder.iterdir()} == {
        f"{name}.{suffix}" for name in names for suffix in ("png", "svg")
    }
    for name in names:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        assert ElementTree.parse(folder / f"{name}.svg").getroot().tag.endswith("svg")
    parsed = check_page((figures[0] / "report.html").read_text("utf-8"))
    assert parsed.tags.count("svg") == parsed.tags.count("figure") == 4
    assert parsed.tags.count("figcaption") == 4


def test_equal_runs_write_equal_files(figures):
    first, second = map(read, figures)
    assert first.pop("run") != {}
    assert second.pop("run") != {}
    assert list(second["items"]) == ["fig4.1"]
    assert first | {"items": {"fig4.1": first["items"]["fig4.1"]}} == second
    for path in (figures[1] / "figures").iterdir():
        assert path.read_bytes() == (figures[0] / "figures" / path.name).read_bytes()


def test_reference_is_more_accurate_than_double(figures):
    readings = read(figures[0])["items"]["fig4.1"]["readings"]
    assert all(0 < part["reference_error"] < 1e-30 for part in readings.values())


def test_slopes_and_distance(figures):
    readings = read(figures[0])["items"]["fig4.2"]["readings"]
    for runs in readings.values():
        assert max(max(run["distance"]) for run in runs.values()) < 1e-14
        assert runs["CG4a"]["slope"] == pytest.approx(4, abs=0.1)
        assert runs["CG5a"]["slope"] == pytest.approx(5, abs=0.1)
        assert runs["CG6a"]["slope"] < 2


def test_methods_of_high_order(tmp_path, monkeypatch):
    monkeypatch.setattr(fig4_2_quad, "_HIGH_POWERS", range(3, 8))
    assert main(["--only", "beyond.order", "--out", str(tmp_path)]) == 0
    part = read(tmp_path)["items"]["beyond.order"]["readings"]["momentum"]
    assert 0 < part["reference_error"] < 1e-40
    assert {"CG6a", "CG6b", "CF8a"} <= set(part["methods"])
    for name, run in part["methods"].items():
        assert len(run["h"]) == 5
        if name == "CG6a":
            assert run["error"][-1] > 1e-8
        else:
            assert run["local"][-1] == pytest.approx(methods[name].order, abs=0.1)


def test_only_accepts_several_items(tmp_path, capsys):
    assert main(["--only", "table3.2, appendix", "--out", str(tmp_path)]) == 0
    assert list(read(tmp_path)["items"]) == ["table3.2", "appendix"]
    assert main(["--only", "table3.2,fig9.9,nothing"]) == 2
    message = capsys.readouterr().err
    assert "'fig9.9', 'nothing'" in message
    assert all(name in message for name in report.ITEMS)


def test_finished_items_remain_after_a_later_failure(tmp_path):
    def fail(context):
        raise RuntimeError("power cut")

    run_module.check_output(tmp_path)
    broken = replace(report.ITEMS["fig4.1"], compute=fail)
    with pytest.raises(RuntimeError, match="power cut"):
        run_module.run([report.ITEMS["table3.2"], broken], tmp_path, Settings(), 1)
    assert list(read(tmp_path)["items"]) == ["table3.2"]
    check_page((tmp_path / "report.html").read_text("utf-8"))


def test_rejects_numbers_that_json_cannot_represent(tmp_path):
    run_module.check_output(tmp_path)
    broken = replace(report.ITEMS["fig4.1"], compute=lambda context: {"x": float("nan")})
    refuses(ValueError, "JSON", run_module.run, [broken], tmp_path, Settings(), 1)


def test_coefficients_are_rounded_from_all_digits():
    assert fixed("0.12345678901234565001", 16) == "0.1234567890123457"
    assert fixed("-1.5", 3) == "−1.500"
    assert fixed("0", 2) == "0.00"
    values = dict(method_data(methods["CG4"], 4)["coefficients"])
    a = methods["CG4"].exact[0]
    assert values["a32"] == to_decimal(a[2][1])
    assert values["c4"] == to_decimal(sum(a[3]))
    assert len(labels(16)) == len(set(labels(16))) == 152


def test_quad_slope_is_resolved_below_double_precision():
    errors = {2**k: 3 * 2.0 ** (-5 * k) for k in range(4, 20, 2)}
    data = order_data(errors)
    assert data["slope"] == pytest.approx(5)
    assert data["error"][-1] < 1e-26


def test_documented_counts_of_verdicts():
    counts = [sum(claim.default_verdict == verdict for claim in CLAIMS) for verdict in VERDICTS]
    assert sum(counts) == len(CLAIMS)
    assert all(bool(claim.interpretation) == (claim.default_verdict == "fail") for claim in CLAIMS)
    text = (Path(__file__).parents[2] / "docs/reproduction.md").read_text(encoding="utf-8")
    passed, failed, other = counts
    expected = f"Of {len(CLAIMS)} claims {passed} pass by default, {failed} fail, and {other} is"
    assert expected in text
    rows = text.partition("| claim that fails | result |\n|---|---|\n")[2].partition("\n\n")[0]
    assert len(rows.splitlines()) == failed


@pytest.mark.slow
def test_whole_default_run(tmp_path):
    assert main(["--out", str(tmp_path)]) == 0
    results = read(tmp_path)["items"]
    assert list(results) == list(report.ITEMS)
    assert results["search4"]["distinct"] >= 50
    assert results["search5"]["distinct"] >= 1
    slopes = results["fig4.2quad"]["readings"]["momentum"]["methods"]
    for name, order in (("CG4", 4), ("CG4a", 4), ("CG5a", 5)):
        assert slopes[name]["slope"] == pytest.approx(order, abs=0.05)
        assert slopes[name]["error"][-1] < 2e-17
    for name, run in results["beyond.order"]["readings"]["momentum"]["methods"].items():
        if name != "CG6a":
            assert run["slope"] == pytest.approx(methods[name].order, abs=0.02)
    verdicts = results["claims"]["count"]
    assert sum(verdicts.values()) == len(CLAIMS)
    verdicts = {claim.text: claim.default_verdict for claim in CLAIMS}
    assert {c["claim"]: c["verdict"] for c in results["claims"]["claims"]} == verdicts
    for claim in results["claims"]["claims"]:
        assert bool(claim["interpretation"]) == (claim["verdict"] == "fail")
    parsed = check_page((tmp_path / "report.html").read_text("utf-8"))
    assert parsed.tags.count("section") == len(report.ITEMS)
    assert parsed.tags.count("figure") == 8


def test_damaged_checkpoint_is_named(tmp_path, capsys):
    """A full disk may leave such a file."""
    run_module.check_output(tmp_path)
    search.compute(replace(search.PLANS[4], starts=1), context(tmp_path / "checkpoints"))
    (store,) = (tmp_path / "checkpoints").glob("search4-*.jsonl")
    store.write_bytes(b"\0" * 5000)
    assert main(["--only", "search4", "--workers", "1", "--out", str(tmp_path)]) == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"reproduce-paper: error: store {store} isn't a file of runs")
    assert message.endswith("; if you delete that file, its content is computed again")


def test_full_run_has_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments in ([], ["--full"]):
        assert main(["--only", "table3.2", *arguments]) == 0
    for folder, full in (("reproduce/out", False), ("reproduce/out/full", True)):
        assert read(tmp_path / folder)["settings"] == {"seed": 0, "full": full}


def test_pages_escape_texts_and_write_numbers():
    run = {"version": "<b>", "seconds": {}, "workers": 1}
    assert "<b>" not in page({"settings": {"seed": 0, "full": False}, "items": {}, "run": run}, {})
    assert [number(-1.5e-7, 2), number(None), number(196)] == ["−1.5e−07", "–", "196"]


def test_list(capsys):
    assert main(["--list"]) == 0
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()] == list(report.ITEMS)
