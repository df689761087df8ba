"""Methods of many stages: only what is shown is computed, and values left out are named."""

import random
import time

import pytest

import cg
from cg.command import main
from cg.construction.catalogue import save
from cg.construction.catalogue.summary import compute_summary
from cg.construction.formats.notebooks import to_html
from cg.construction.methods.stability import too_large


def dense(stages):
    """Return a method of random rationals, whose common denominator has many digits."""
    draw = random.Random(stages)

    def row(length):
        return [f"{draw.randint(1, 10**6)}/{draw.randint(1, 10**6)}" for _ in range(length)]

    return cg.Tableau([row(i) for i in range(stages)], row(stages), name=f"dense {stages}")


@pytest.mark.parametrize("stages", [60, 150])
def test_show_names_values_that_are_not_computed(stages, tmp_path, capsys):
    file = tmp_path / "dense.toml"
    save(dense(stages), file)
    begin = time.process_time()
    assert main(["show", str(file)]) == 0
    assert time.process_time() - begin < 20
    lines = capsys.readouterr().out.splitlines()
    (words,) = (line.split(maxsplit=2) for line in lines if line.startswith("  not computed"))
    assert words[2].startswith(f"limits of stability, since with {stages} stages and a common")
    assert not any("stable on" in line for line in lines)
    with pytest.raises(ValueError, match=r"method must have .*: limits of stability"):
        cg.plot.stability_region(dense(stages))


def test_small_coefficients_with_many_stages():
    assert compute_summary(dense(12)).not_computed is None
    # Euler's method, 60 times
    assert too_large(cg.Tableau([["1/60"] * i for i in range(60)], ["1/60"] * 60)) is None


def test_notebook_output_is_bounded(monkeypatch):
    from cg.construction.formats import latex

    written = []
    shown = latex._shown
    monkeypatch.setattr(latex, "_shown", lambda entry: written.append(entry) or shown(entry))
    text = to_html(dense(100))
    assert "and 61 more" in text
    assert len(written) <= 40 * 101
    written.clear()
    points = [(m - 1, {0: f"1/{m + 7}"}) for m in range(200)]
    assert "and 161 more" in to_html(cg.CommutatorFree(points, [-1], 199))
    assert len(written) <= 200
