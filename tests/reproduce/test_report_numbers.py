"""Numbers of the paper, the table of the catalogue, digests of code, the display of progress."""

import hashlib
import io
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from kinds import FROZEN

import cg
from cg.construction.catalogue import methods
from cg.construction.conditions import count
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.proofs.packed import certificate_names
from cg.problems import HeavyTop
from cg.reproduce import catalogue_table, fingerprint, quad_orders
from cg.reproduce.blocks import Context, Settings
from cg.reproduce.coefficients import printed
from cg.reproduce.main import main
from cg.reproduce.quad_steps import end_point
from cg.reproduce.report import ITEMS
from cg.reproduce.run import Display

# of every printed digit of Appendix A, row by row: label, an equals sign, the digits
DIGITS = {
    "CG4a": (20, "226f637c8ef75d4c"),
    "CG5a": (54, "1dd7d84fb97ac0c0"),
    "CG6a": (152, "36443d7e89620d3f"),
}


@pytest.mark.parametrize("name", DIGITS)
def test_printed_digits_have_their_checksum(name):
    lines = [f"{label}={digits}" for label, digits in printed()[name].labelled()]
    total = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    assert (len(lines), total) == DIGITS[name]


def test_digests_change_with_files_and_arguments(tmp_path, monkeypatch):
    monkeypatch.setattr(fingerprint.cg, "__file__", str(tmp_path / "__init__.py"))
    path = tmp_path / "folder" / "module.py"
    path.parent.mkdir()
    digests = []
    for text, order in (("x = 1", 4), ("x = 1", 4), ("x = 1", 5), ("x = 2", 4)):
        path.write_text(text)
        fingerprint.package_digest.cache_clear()
        digests.append(fingerprint.digest(order=order))
    fingerprint.package_digest.cache_clear()
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


def test_progress(monkeypatch):
    pytest.importorskip("tqdm")
    monkeypatch.setattr(cg.reproduce.run, "_DELAY", 0.0)
    stream = io.StringIO()
    items = [ITEMS["table3.2"], ITEMS["search4"]]
    display = Display(stream, items)
    update = display.begin(items[0])
    for done in range(1, 11):
        update(done, 10)
    display.finish(items[0], 200.0)
    text = stream.getvalue()
    title = f"[1/2] {items[0].title}"
    assert f"{title}: 100%" in text
    assert "10/10" in text
    assert text.endswith(f"\n{title}: 200.0 s\n")


def test_progress_in_quadruple_precision_counts_flows(tmp_path, monkeypatch):
    monkeypatch.setattr(quad_orders, "order_data", lambda errors: {})
    shown = []
    given = Context(Settings(), tmp_path, workers=1, progress=lambda *done: shown.append(done))
    steps = {"CG4": [2, 4, 8], "CG6a": [2, 8]}
    quad_orders.convergence(given, steps)
    few, many = (cg.methods[name].exponentials for name in steps)
    total = 14 * few + 10 * many
    finished = np.cumsum([0, 8 * few, 8 * many, 4 * few, 2 * few, 2 * many])
    assert shown == [(100 * work // total, 100) for work in finished]


@pytest.mark.parametrize("name", [name for name, method in FROZEN.items() if method.explicit])
def test_steps_agree_with_those_in_double(name):
    top = HeavyTop("velocity")
    options = {"frame": top.frame, "method": name, "h": 1 / 16}
    double = cg.integrate(top.f, (0, 1), top.y0, **options).y[-1]
    end = end_point(top, cg.methods[name], 16)
    np.testing.assert_allclose(double, [float(x) for x in end], rtol=0, atol=2e-14)


def test_rotations_are_orthogonal_to_rounding():
    method, steps = cg.methods["CG3"], 1000
    rotation = np.array(end_point(HeavyTop(), method, steps)[:9]).reshape(3, 3)
    off = abs(rotation @ rotation.T - np.eye(3, dtype=int)).max()
    # a few roundings down in each flow, which add up
    assert off < 8 * method.exponentials * steps * 2.0**-114


@pytest.mark.parametrize(("arguments", "named"), [
    (["--seed", "-1"], "--seed"), (["--seed", "one"], "--seed"), (["--workers", "0"], "--workers"),
    (["--workers", "1.5"], "--workers"), (["--frequency"], "--frequency"),
    (["--only", "fig9.9"], "fig9.9"),
])  # fmt: skip
def test_rejects_wrong_arguments(arguments, named, capsys):
    assert main(arguments) == 2
    assert named in capsys.readouterr().err


def test_rejects_folders_before_work_begins(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("cg.reproduce.run.run", lambda *_: pytest.fail("work has begun"))
    path = tmp_path / "taken"
    path.write_text("mine")
    wrong = [(path, f"{path} is not a directory"), (path / "below", "is not a directory")]
    if sys.platform == "linux":  # whose /proc takes no folders, not even from root
        wrong.append(("/proc/nothing", "/proc/nothing is not writable"))
    for out, message in wrong:
        assert main(["--out", str(out)]) == 2
        assert message in capsys.readouterr().err
    assert path.read_text() == "mine"


PAGE = Path(__file__).parents[2] / "docs" / "catalogue.md"


@pytest.fixture(scope="module")
def catalogue():
    return {entry["name"]: entry for entry in catalogue_table.entries()}


def test_properties(catalogue):
    assert sorted(catalogue) == sorted(FROZEN)
    entry = catalogue["CG4a"]
    assert (entry["order"], entry["embedded_order"], entry["approximate"]) == (4, None, False)
    assert (entry["stages"], entry["exponentials"]) == (5, 15)
    assert entry["largest_coefficient"] == 1.3918565724203246
    # the one dependent condition of CG5a is known
    assert (entry["rank"], catalogue["CG5a"]["rank"]) == (13, 37)
    for name, actual in catalogue.items():
        assert actual["conditions"] == count(actual["order"], independent=True)
        assert 0 < actual["rank"] <= actual["conditions"]
        assert actual["approximate"] == (actual["max_residual"] > 1e-32) == (name == "CG6a")
        assert actual["principal_error"] > 1e-5


def test_catalogue_section_shows_certificates(catalogue):
    rows = {row[0]: row[-1] for row in catalogue_table.table(catalogue.values()).rows}
    proved = {name for name, actual in catalogue.items() if actual["certificate"]}
    assert proved == {n for n, cell in rows.items() if cell != "–"}
    assert proved == {*certificate_names()} & {*FROZEN}
    assert rows["CG6a"] == "–"
    assert rows["LieEuler"] == "0"
    assert rows["CG4a"].endswith("e−36")


def test_table_in_docs_matches_the_catalogue(catalogue):
    shown = catalogue_table.markdown(catalogue_table.table(catalogue.values()))
    page = PAGE.read_text("utf-8")
    assert shown in page, "out of date; run python tools/update_catalogue.py"
    advice = page.partition("## Which method to use")[2].partition("## The table")[0]
    named = set(re.findall(r"`([A-Z]\w+(?:\(\d\)\w?)?)`", advice))
    assert len(named) > 8
    assert named <= set(methods)


RECOMMENDED = {
    "effort": "CG4b CG6f CF4r CF5d CF6b CF7b",
    "exponentials": "CG4c CG5c CG6g CF4 CF5c CF6d DOP853 CF7b",
    "stages": "CG5d CG6g CG7b CF4 CF5b CF6a CF7c CF8a",
    "principal_error": "CG5b CG6e CF4r CF5e",
}


@pytest.mark.parametrize(
    ("name", "by"), [(name, by) for by, names in RECOMMENDED.items() for name in names.split()]
)
def test_recommended_methods_are_best_in_their_class(catalogue, name, by):
    # Crouch–Grossman methods among themselves, others among all
    rivals = {
        other["name"]: other[by]
        for other in catalogue.values()
        if other["explicit"] and other["order"] == methods[name].order
        if not (name.startswith("CG") and isinstance(methods[other["name"]], CommutatorFree))
    }
    assert rivals[name] == min(rivals.values())
