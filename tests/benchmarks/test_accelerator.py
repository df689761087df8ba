"""The measurement of accelerators runs on the CPU."""

import json

import numpy as np
import pytest
from jax_setup import jax

from benchmarks import accelerator

pytestmark = pytest.mark.no_core


def test_one_row():
    row = accelerator.measure(jax.devices("cpu")[0], 3, "fixed", np.float64, 1)
    assert row["mean_steps"] == 100.0
    assert row["drift"] < 1e-14


@pytest.mark.slow
def test_the_table(tmp_path, capsys):
    file = tmp_path / "numbers.json"
    accelerator.main(["--members", "1000", "--rounds", "1", "--json", str(file)])
    rows = json.loads(file.read_text(encoding="utf-8"))
    assert [(row["steps"], row["precision"]) for row in rows] == [
        ("fixed", "float64"), ("fixed", "float32"), ("chosen", "float64"), ("chosen", "float32"),
    ]  # fmt: skip
    assert all(row["drift"] < 1e-6 for row in rows)
    assert capsys.readouterr().out.count("\n") == 2 + len(rows)
