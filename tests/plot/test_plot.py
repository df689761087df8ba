"""Contents of plots, read from their axes."""

import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot as plt
from refusals import refuses
from scipy.spatial.transform import Rotation

import cg
from cg.construction.trees import OrderedTree
from cg.plot.methods import growth
from cg.plot.style import COLOURS


@pytest.fixture
def ax():
    return plt.figure().add_subplot()


@pytest.fixture
def spatial_axes():
    return plt.figure().add_subplot(projection="3d")


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_matplotlib_is_imported_lazily():
    code = "import cg; cg.plot.tree; import sys; print('matplotlib' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"


class TestTrees:
    def test_nodes_and_edges(self, ax):
        cg.plot.tree("[[][[]]]", ax)
        assert len(ax.lines) == 3
        ends = sorted(tuple(line.get_xydata().ravel()) for line in ax.lines)
        assert ends == [(0.0, 0.0, -0.5, 1.0), (0.0, 0.0, 0.5, 1.0), (0.5, 1.0, 0.5, 2.0)]
        assert ax.collections[0].get_offsets().shape == (4, 2)
        assert ax.get_xlabel() == "[[][[]]]   γ = 3"
        assert cg.plot.tree(OrderedTree.parse("[[]]")).get_xlabel().startswith("[[]] ")


class TestMethods:
    def test_a_tableau(self, ax):
        cg.plot.tableau("CG2(3)", ax)
        assert ax.get_title() == "CG2(3): order 3(2), 3 evaluations, 6 flows"
        expected = ["0", "3/4", "3/4", "17/24", "119/216", "17/108"]
        expected += ["13/51", "−2/3", "24/17", "17/54", "19/54", "1/3"]
        assert texts(ax) == expected
        rows = {text.get_text(): text.get_position() for text in ax.texts}
        assert rows["119/216"][0] == rows["13/51"][0] == 1
        assert rows["13/51"][1] < rows["17/108"][1] < rows["3/4"][1]
        assert "0.8177" in texts(cg.plot.tableau("CG4a"))

    def test_points(self, ax):
        method = cg.methods["CF4"]
        cg.plot.points(method, ax)
        assert texts(ax)[:3] == ["1/2 F1", "1/2 F2", "−1/2 F1 + 1 F3"]
        assert texts(ax)[3] == "1/4 F1 + 1/6 F2\n+ 1/6 F3 − 1/12 F4"
        assert texts(ax)[-4:] == ["1", "2", "3", "4"]
        places = [text.get_position() for text in ax.texts[-4:]]
        np.testing.assert_allclose([x for x, _ in places], method.c)
        assert len(set(places)) == 4
        assert len(ax.lines) == method.exponentials
        assert [text.get_text() for text in ax.get_legend().get_texts()] == ["result", "stages"]
        assert ax.get_xlabel() == "time of the point, in steps"


class TestStability:
    def test_the_boundary(self, ax):
        cg.plot.stability_region("CG2", ax)
        (boundary,) = [c for c in ax.collections if len(c.get_edgecolors()) and not c.filled]
        path = np.concatenate([p.vertices for p in boundary.get_paths()])
        size = np.abs(growth(cg.methods["CG2"], path[:, 0] + 1j * path[:, 1]))
        np.testing.assert_allclose(size, 1.0, atol=5e-3)
        assert path[:, 0].min() == pytest.approx(-2.0, abs=0.01)
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("Re hλ", "Im hλ")
        left, right = ax.get_xlim()
        assert -3 < left < -2
        assert 0 < right < 1


class TestErrors:
    def test_convergence(self, ax):
        h = np.array([0.4, 0.1, 0.2, 0.05])
        cg.plot.convergence(h, 3 * h**4, ax, label="mine", order=4)
        cg.plot.convergence(h, 5 * h**3, ax, label="other")
        curve, guide, second = ax.lines
        np.testing.assert_array_equal(curve.get_xdata(), np.sort(h))
        np.testing.assert_allclose(curve.get_ydata(), 3 * np.sort(h) ** 4)
        np.testing.assert_allclose(guide.get_ydata(), 3 * h**4)
        assert texts(ax) == ["order 4"]
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("step size h", "error")
        assert [text.get_text() for text in ax.get_legend().get_texts()] == ["mine", "other"]
        looks = {(c.get_color(), c.get_linestyle(), c.get_marker()) for c in (curve, second)}
        assert len(looks) == 2


class TestTrajectories:
    def test_on_the_sphere(self, spatial_axes):
        run = cg.integrate(
            lambda t, y: [0, 0, 1], (0, 1), [2.0, 0, 0], frame=cg.frames.Euclidean(3),
            method="CG3", h=0.25,
        )  # fmt: skip
        cg.plot.trajectory_on_sphere(run, spatial_axes, label="one")
        cg.plot.trajectory_on_sphere(run.y, spatial_axes)
        first, second = spatial_axes.get_lines()
        np.testing.assert_array_equal(np.stack(first.get_data_3d(), axis=1), run.y)
        assert (first.get_color(), second.get_color()) == COLOURS[:2]
        assert first.get_linestyle() != second.get_linestyle()
        draw = lambda: cg.plot.trajectory_on_sphere(run.y, spatial_axes).get_lines()[-1]
        styles = {(line.get_color(), line.get_linestyle()) for line in (draw() for _ in range(8))}
        assert len(styles) == 8
        labels = spatial_axes.get_xlabel(), spatial_axes.get_ylabel(), spatial_axes.get_zlabel()
        assert labels == ("x", "y", "z")
        spheres = [part for part in spatial_axes.collections if part.get_gid() == "cg-sphere"]
        assert len(spheres) == 1


@pytest.mark.parametrize("values", [
    [[1.0, 2.0], [np.nan, np.nan], [3.0, np.nan]], [[np.nan] * 2] * 3
])  # fmt: skip
def test_bands_have_gaps_where_no_member_has_a_number(ax, values):
    cg.plot.bands([0, 1, 2], values, ax, label="angle")
    rows = [[x for x in row if x == x] for row in np.asarray(values).tolist()]
    expected = [np.median(row) if row else np.nan for row in rows]
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), expected)


ONES, ROTATIONS = np.ones((5, 4)), Rotation.from_rotvec(np.linspace(0, 1, 5)[:, None] * [0, 0, 1])
BAD = [
    (cg.plot.tree, "text", [{"tree": "[[]"}]),
    (cg.plot.tree, "tree", [{"tree": 3}, {"tree": "[" * 201 + "]" * 201}]),
    (cg.plot.tree, "ax", [{"tree": "[]", "ax": "ax"}]),
    (cg.plot.points, "method", [{"method": "DICG4"}, {"method": "Leapfrog"}]),
    (cg.plot.tableau, "method", [{"method": "XX"}, {"method": "Leapfrog"}]),
    (cg.plot.stability_region, "method", [{"method": []}, {"method": "Leapfrog"}]),
    (cg.plot.trajectory_on_sphere, "ax", [{"y": np.eye(3), "ax": None}]),
    (cg.plot.trajectory_on_sphere, "y", [{"y": np.ones((3, 4))}, {"y": np.nan * np.eye(3)}]),
    (cg.plot.bands, "values", [{"t": [0, 1], "values": [1, 2]}]),
    (cg.plot.bloch, "y", [{"y": np.ones((3, 5))}, {"y": [[1, np.nan]]}]),
    (cg.plot.bloch, "y must hold points at one or more times", [{"y": []}]),
    (cg.plot.trajectory_of_axes, "y", [{"y": ONES[:, :2]}, {"y": ONES}]),
    (cg.plot.convergence, "h", [{"h": [0.1, 0.2], "errors": [1e-3]}, {"h": "ab", "errors": [1.0]}]),
    (cg.plot.convergence, "h", [{"h": [0.1, -0.2], "errors": [1e-3, 1e-3]}]),
    (
        cg.plot.convergence,
        "errors",
        [{"h": [0.1, 0.2], "errors": e} for e in ([1, np.nan], [0, 0])],
    ),
    (cg.plot.convergence, "order", [{"h": [0.1], "errors": [0.1], "order": -1}]),
    (cg.plot.attitude, "y", [{"y": np.zeros(n)} for n in ((2, 5), (2, 3, 3), (0, 4))]),
    (cg.plot.attitude, "y", [{"y": np.full((2, 4), np.nan)}]),
    (cg.plot.attitude, "show", [{"y": ROTATIONS, "show": show} for show in ("Xyz", "xxz")]),
    (cg.plot.attitude, "t", [{"y": ROTATIONS, "t": t} for t in ([0, 1], [0, 1, 1, 2, 3])]),
]


@pytest.mark.parametrize(
    ("function", "name", "arguments"), [(f, name, one) for f, name, calls in BAD for one in calls]
)
def test_bad_arguments_are_named(ax, function, name, arguments):
    given = arguments | {"ax": ax} if arguments.get("ax", 0) is None else arguments
    refuses((TypeError, ValueError), rf"\b{name}\b", function, **given)


class TestAttitude:
    turns = Rotation.from_rotvec(np.linspace(0.1, 1.1, 5)[:, None] * [0.1, -0.2, 0.9])
    t = np.linspace(0, 2, 5)

    @pytest.mark.parametrize(("show", "curves"), [
        ("ZYX", turns.as_euler("ZYX", degrees=True)),
        ("xyx", turns.as_euler("xyx", degrees=True)),
        ("vector", np.rad2deg(turns.as_rotvec())),
    ])  # fmt: skip
    def test_shows(self, ax, show, curves):
        cg.plot.attitude(self.turns, ax, show=show, t=self.t)
        assert len(ax.lines) == 3
        for line, curve in zip(ax.lines, curves.T, strict=True):
            np.testing.assert_array_equal(line.get_xdata(), self.t)
            np.testing.assert_allclose(line.get_ydata(), curve, atol=1e-12)

    @pytest.mark.parametrize(("frame", "y0"), [
        (cg.frames.SO3(), np.eye(3)),
        (cg.frames.UnitQuaternion(scalar_first=True), [1.0, 0, 0, 0]),
        (cg.frames.SE3(), np.eye(4)),
        (cg.frames.Product(cg.frames.Euclidean(2), cg.frames.SO3()), [1, 1, *np.eye(3).flat]),
    ], ids=str)  # fmt: skip
    def test_reads_solutions(self, ax, frame, y0):
        coefficients = np.zeros(frame.dim)
        coefficients[2 if isinstance(frame, cg.frames.Product) else 0] = 0.5
        run = cg.solve_ivp(lambda t, y: coefficients, (0, 3), y0, frame=frame, dense_output=True)
        cg.plot.attitude(run, ax, show="vector")
        times, angles = ax.lines[0].get_data()
        assert len(times) > 100
        np.testing.assert_allclose(angles, np.rad2deg(0.5 * times), atol=1e-10)


def paths(y, draw=cg.plot.bloch):
    return [np.transpose(line.get_data_3d()) for line in draw(y).lines]


class TestPaths:
    @pytest.mark.parametrize("draw", [cg.plot.trajectory_on_sphere, cg.plot.bloch])
    @pytest.mark.parametrize("dense", [True, False])
    def test_quaternions_are_read_as_their_frame_says(self, draw, dense):
        quaternions = cg.frames.UnitQuaternion
        for frame in (quaternions(), quaternions(scalar_first=True), cg.frames.SO3("space")):
            run = cg.solve_ivp(
                lambda t, y: [1.0, 0.3, 0.0], (0, 1), frame.random_point(np.random.default_rng(0)),
                frame=frame, dense_output=dense,
            )  # fmt: skip
            expected = frame.as_rotation(run.y[[0, -1]]).apply([0.0, 0.0, 1.0])
            assert np.abs(paths(run, draw)[0][[0, -1]] - expected).max() < 1e-12

    def test_points_of_other_frames_are_no_rotations(self):
        sphere = cg.frames.Sphere(3)
        run = cg.solve_ivp(lambda t, y: [1.0, 0, 0, 0, 0, 0], (0, 1), [1.0, 0, 0, 0], frame=sphere)
        refuses(ValueError, r"\(n, 4\) of rotations, got \(\d+, 4\) on Sphere", paths, run)

    def test_members_are_drawn_between_their_steps_and_up_to_their_ends(self):
        def f(t, y, p):
            return [0.2, 0.0, 1.0 + y[0] if p[0] < 2 or t < 5 else np.nan]

        with pytest.warns(UserWarning, match="Failure of 1 of 2"):
            runs = cg.solve_ensemble(
            f, (0, 10), [1.0, 0, 0], frame=cg.frames.Sphere(2), parameters=[[1.0], [3.0]],
            rtol=1e-6, dense_output=True,
        )  # fmt: skip
        assert runs.status.tolist() == [0, -1]
        for draw in (cg.plot.trajectory_on_sphere, cg.plot.bloch):
            assert draw(runs, label="two").lines[0].get_label() == "two"
            for k, path in enumerate(paths(runs, draw)):
                exact = runs[k].sol(np.linspace(0, runs[k].t[-1], 300))
                distances = np.linalg.norm(path[:, None] - exact, axis=-1)
                assert distances.min(0).max() < 0.02
                assert distances.min(1).max() < 0.1
        assert runs[1].t[-1] < 5.01

    def test_matrices_are_densities_or_unitary(self):
        densities = np.array([[[0.5, -0.5j], [0.5j, 0.5]]] * 3)
        assert np.abs(paths(densities)[0][0] - [0.0, 1.0, 0.0]).max() < 1e-12
        densities[2] *= 0.9
        refuses(ValueError, "got one of trace 0.9", cg.plot.bloch, densities)


def test_dashes_are_no_matter_of_the_settings_of_matplotlib():
    """A cycle of dashes there would make edges of trees and flows look different."""
    cycle = matplotlib.cycler(linestyle=["-", "--", ":"])
    with plt.rc_context({"axes.prop_cycle": cycle}):
        draws = [cg.plot.tree("[[][]]"), cg.plot.points("CF4"), cg.plot.tableau("CG3")]
    assert {line.get_linestyle() for ax in draws for line in ax.lines} == {"-"}
    lines = cg.plot.trajectory_of_axes(ROTATIONS).lines[::3]
    assert len({line.get_linestyle() for line in lines}) == 3


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
    cg.plot.invariants(run, lambda y: top.invariants(y)["energy"], ax)
    np.testing.assert_array_equal(ax.lines[-1].get_ydata(), ax.lines[-2].get_ydata())


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
    (line,) = paths(y)
    np.testing.assert_allclose(line[[0, -1]], np.array(VECTORS)[[0, -1]], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.0, atol=1e-12)
    for vector in VECTORS:
        assert np.linalg.norm(line - vector, axis=1).min() < 1e-12


class TestKindsOfPoints:
    def test_give_the_same_path(self):
        """A rotation about x from |0⟩, as spins, vectors, rotations, and densities in a row."""
        angles = np.linspace(0, 2, 9)
        kets = np.stack([np.cos(angles / 2), -1j * np.sin(angles / 2)], axis=1)
        densities = (kets[:, :, None] * kets[:, None].conj()).reshape(-1, 4)
        turns = cg.frames.SO3().flow(angles[:, None] * [1.0, 0.0, 0.0], np.eye(3))
        quaternions = cg.frames.UnitQuaternion().flow(
            angles[:, None] * [1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]
        )
        (path,) = paths(kets)
        for y in (densities, turns, turns[:, :, 2], quaternions):
            np.testing.assert_allclose(paths(y)[0], path, atol=1e-12)

    def test_dense_solutions(self):
        """Between steps the solution is drawn, here a small circle, and no great circle."""
        run = cg.solve_ivp(
            lambda t, y: [0.0, 0.0, 1.0], (0, 6), [0.6, 0.0, 0.8], frame=cg.frames.Sphere(2),
            dense_output=True,
        )  # fmt: skip
        np.testing.assert_allclose(paths(run)[0][:, 2], 0.8, atol=1e-12)
        assert {text.get_text() for text in cg.plot.bloch(run).texts} == {"|0⟩", "|1⟩"}

    def test_states_of_qutip(self):
        qutip = pytest.importorskip("qutip")
        states = [qutip.basis(2, 0), (qutip.basis(2, 0) + qutip.basis(2, 1)).unit()]
        (path,) = paths(states)
        np.testing.assert_allclose(path[-1], [1.0, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(paths([state.proj() for state in states])[0], path)
