"""The code in the README and in other pages runs."""

import numpy as np
from tests_of_pages import blocks_of, run, source_in


def test_code_of_readme_runs():
    assert len(blocks_of("README.md")) == 3
    names = run("README.md")
    assert names["solution"].success
    assert names["four"]
    assert names["free"]
    assert names["five"].order == 5
    assert names["proof"].order == names["method"].order == 6


def test_code_of_frames_page(capsys):
    names = run("docs/frames.md")
    assert capsys.readouterr().out == source_in("docs/frames.md", "text")
    spiral = names["spiral"]
    # latitude: z' = -(1 - z^2) / 2; longitude grows with time
    z = -np.tanh(spiral.t / 2)
    expected = np.stack([np.cos(spiral.t), np.sin(spiral.t), z], axis=-1)
    expected[:, :2] *= np.sqrt(1 - z * z)[:, None]
    np.testing.assert_allclose(spiral.y, expected, atol=1e-7)

    eigenvalues, vectors = np.linalg.eigh(names["lattice"])
    np.testing.assert_allclose(names["sorted_"].y[-1], np.diag(eigenvalues[::-1]), atol=1e-5)
    columns = names["columns"].y[-1]
    np.testing.assert_allclose(columns @ columns.T, vectors[:, 1:] @ vectors[:, 1:].T, atol=1e-5)
    momentum, vertical = names["top"].y[:, :3], names["top"].y[:, 3:]
    np.testing.assert_allclose(np.vecdot(vertical, vertical), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.vecdot(momentum, vertical), 1.32, atol=1e-14)
    assert names["course"].success


def test_code_of_problems_page():
    assert run("docs/problems.md")["error"] < 1e-8


def test_code_of_pages_on_lifting_and_low_storage():
    assert run("docs/lifting.md")["lifted"].flows == 4
    assert run("docs/low_storage.md")["williamson"].order == 3


def test_code_of_munthe_kaas_page():
    assert run("docs/rkmk.md")["heun"].order == 2


def test_code_of_runs_page(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = run("docs/runs.md")
    files = {"runs.jsonl", "Mine.toml", "Mine.certificate.toml"}
    assert {path.name for path in tmp_path.iterdir()} == files
    assert names["certificate"].order == names["method"].order == 4
    result, lines = names["result"], capsys.readouterr().out.splitlines()
    assert lines[0] == repr(result)
    exact = sum(start.exact for start in result.starts)
    assert exact > 10
    method = names["method"]
    assert lines[1] == f"{method.name} {method.principal_error}"
    assert method.c.max() <= 1.0
    assert lines[2] == "search 4 200"
