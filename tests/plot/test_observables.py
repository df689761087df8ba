"""Plots of numbers over time, and Bloch vectors."""

import numpy as np
import pytest

import cg

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_invariants_are_drawn_from_their_start():
    top = cg.problems.HeavyTop()
    run = cg.integrate(top.f, (0, 1), top.y0, frame=top.frame, method="CG3", h=0.1)
    ax = cg.plot.invariants(run, top.invariants)
    values = top.invariants(run.y)
    assert [line.get_label() for line in ax.lines] == list(values)
    for line, value in zip(ax.lines, values.values(), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), abs(value - value[0]))
    cg.plot.invariants(run, {"energy": lambda y: top.invariants(y)["energy"]}, ax)
    assert ax.get_yscale() == "log"


STATES = np.array([[1, 0], [0, 1], [1, 1], [1, 1j]], dtype=complex)
STATES /= np.linalg.norm(STATES, axis=1)[:, None]
VECTORS = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize("y", [
    STATES,
    STATES[:, :, None] * STATES[:, None].conj(),
    np.stack([STATES, np.stack([-STATES[:, 1].conj(), STATES[:, 0].conj()], 1)], -1),
], ids=["states", "densities", "propagators"])  # fmt: skip
def test_bloch_vectors(y):
    line = cg.plot.bloch(y).lines[0]
    np.testing.assert_allclose(np.transpose(line.get_data_3d()), VECTORS, atol=1e-15)
