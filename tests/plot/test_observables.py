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
    for functions in (lambda y: y[:, 0], {}, lambda y: {}):
        with pytest.raises(TypeError, match="functions must be one that returns a dict, or a"):
            cg.plot.invariants(run, functions)


STATES = np.array([[1, 0], [0, 1], [1, 1], [1, 1j]], dtype=complex)
STATES /= np.linalg.norm(STATES, axis=1)[:, None]
VECTORS = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize("y", [
    STATES,
    STATES[:, :, None] * STATES[:, None].conj(),
    np.stack([STATES, np.stack([-STATES[:, 1].conj(), STATES[:, 0].conj()], 1)], -1),
], ids=["states", "densities", "propagators"])  # fmt: skip
def test_bloch_vectors(y):
    """Great circles between them: each is met, and all points are states."""
    line = np.transpose(cg.plot.bloch(y).lines[0].get_data_3d())
    np.testing.assert_allclose(line[[0, -1]], np.array(VECTORS)[[0, -1]], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.0, atol=1e-12)
    for vector in VECTORS:
        assert np.linalg.norm(line - vector, axis=1).min() < 1e-12


class TestKindsOfPoints:
    def lines(self, y, **options):
        lines = cg.plot.bloch(y, **options).lines
        return [np.transpose(line.get_data_3d()) for line in lines]

    def test_give_the_same_path(self):
        """A rotation about x from |0⟩, as spins, vectors, rotations, and densities in a row."""
        angles = np.linspace(0, 2, 9)
        kets = np.stack([np.cos(angles / 2), -1j * np.sin(angles / 2)], axis=1)
        densities = (kets[:, :, None] * kets[:, None].conj()).reshape(-1, 4)
        turns = cg.frames.SO3().flow(angles[:, None] * [1.0, 0.0, 0.0], np.eye(3))
        quaternions = cg.frames.UnitQuaternion().flow(
            angles[:, None] * [1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
        )
        (path,) = self.lines(kets)
        for y in (densities, turns, turns[:, :, 2], quaternions):
            np.testing.assert_allclose(self.lines(y)[0], path, atol=1e-12)

    def test_dense_solutions_and_members(self):
        """Between steps the solution is drawn, here a small circle, and no great circle."""
        run = cg.solve_ivp(
            lambda t, y: [0.0, 0.0, 1.0], (0, 6), [0.6, 0.0, 0.8], frame=cg.frames.Sphere(2),
            dense_output=True,
        )  # fmt: skip
        np.testing.assert_allclose(self.lines(run)[0][:, 2], 0.8, atol=1e-12)
        many = cg.solve_ensemble(
            lambda t, y: [0.0, 0.0, 1.0], (0, 1), [[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]],
            frame=cg.frames.Sphere(2),
        )  # fmt: skip
        ax = cg.plot.trajectory_on_sphere(many, label="two")
        assert ax.lines[0].get_label() == "two"
        assert len(ax.lines) == 2
        assert {text.get_text() for text in cg.plot.bloch(run).texts} == {"|0⟩", "|1⟩"}

    def test_states_of_qutip(self):
        qutip = pytest.importorskip("qutip")
        states = [qutip.basis(2, 0), (qutip.basis(2, 0) + qutip.basis(2, 1)).unit()]
        (path,) = self.lines(states)
        np.testing.assert_allclose(path[-1], [1.0, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(self.lines([state.proj() for state in states])[0], path)
