"""Timelines and phase planes, read from their axes."""

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.colors import to_hex
from refusals import refuses

import cg

PLANE = cg.frames.Euclidean(2)


def height(t, y):
    return y[0]


def bouncing(end=2.5, start=(1.0, 0.0), terminal=0, **options):
    """A ball that loses half its speed, and the highest points of its path."""
    floor = cg.Event(height, direction=-1, terminal=terminal, jump=lambda t, y: [0.0, -0.5 * y[1]])
    return cg.solve_ivp(
        lambda t, y: [y[1], -9.81], (0, end), start, frame=PLANE, rtol=1e-9, atol=1e-9,
        events=[floor, lambda t, y: y[1]], **options,
    )  # fmt: skip


def swings(**options):
    """A pendulum from several angles; the last member fails."""
    with pytest.warns(UserWarning, match="Failure of 1 of 3"):
        return cg.solve_ensemble(
            lambda t, y: [y[1], -np.sin(y[0]) if y[0] > -2.5 else np.nan], (0, 6),
            [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], frame=PLANE, **options,
        )  # fmt: skip


def marks(ax):
    return {line.get_label(): line.get_xydata() for line in ax.lines}


class TestTimeline:
    @pytest.mark.parametrize("options", [{}, {"dense_output": True}, {"t_eval": [0.1, 0.5]}])
    def test_marks_each_event_in_its_row(self, options):
        run = bouncing(terminal=3, **options)
        found = marks(cg.plot.timeline(run))
        assert list(found) == ["event", "jump", "end of the solution"]
        np.testing.assert_array_equal(found["jump"][:, 0], run.t_events[0][:2])
        np.testing.assert_array_equal(found["event"][:, 0], run.t_events[1])
        np.testing.assert_array_equal(found["end of the solution"], [[run.t_events[0][2], 0]])
        assert set(found["event"][:, 1]) == {1.0}

    def test_marks_differ_by_more_than_colour(self):
        lines = cg.plot.timeline(bouncing(terminal=3)).lines
        assert len({line.get_marker() for line in lines}) == 3

    def test_an_end_by_time_is_no_mark(self):
        assert list(marks(cg.plot.timeline(bouncing(end=0.6)))) == ["jump"]
        assert not cg.plot.timeline(bouncing(end=0.1)).lines

    @pytest.mark.parametrize(("events", "names"), [
        (None, ["event 0", "event 1"]),
        (["floor", "a < b"], ["floor", "a < b"]),
        ((cg.Event(height), lambda t, y: 0), ["height", "event 1"]),
    ])  # fmt: skip
    def test_names_of_rows(self, events, names):
        ax = cg.plot.timeline(bouncing(), events=events)
        assert [row.get_text() for row in ax.get_yticklabels()] == names

    @pytest.mark.parametrize("options", [{}, {"dense_output": True}, {"t_eval": [0, 0.3, 0.7, 1]}])
    def test_modes_change_at_jumps(self, options):
        """An entry that counts bounces."""
        floor = cg.Event(height, direction=-1, jump=lambda t, y: [0.0, -0.5 * y[1], y[2] + 1.0])
        run = cg.solve_ivp(
            lambda t, y: [y[1], -9.81, 0.0], (0, 1), [1.0, 0.0, 0.0],
            frame=cg.frames.Euclidean(3), events=floor, **options,
        )  # fmt: skip
        ax = cg.plot.timeline(run, mode=2)
        edges = [0.0, *run.t_events[0], 1.0]
        assert len(ax.collections[:-1]) == len(edges) - 1 >= 2
        for k, bars in enumerate(ax.collections[:-1]):
            assert bars.get_label() == f"mode {k}"
            (path,) = bars.get_paths()
            np.testing.assert_allclose(np.unique(path.vertices[:, 0]), edges[k : k + 2])
        looks = {(to_hex(b.get_facecolor()[0]), b.get_hatch()) for b in ax.collections[:-1]}
        assert len(looks) == len(edges) - 1
        assert [row.get_text() for row in ax.get_yticklabels()] == ["mode", "event 0"]

    def test_modes_have_names(self):
        ax = cg.plot.timeline(bouncing(), mode=lambda y: np.where(y[:, 1] > 0, "rises", "falls"))
        assert [bars.get_label() for bars in ax.collections[:-1]] == ["falls", "rises"]

    def test_backward_in_time(self):
        run = cg.solve_ivp(
            lambda t, y: [1.0, 0.0], (0, -3), [2.5, 0.0], frame=PLANE, dense_output=True,
            events=cg.Event(lambda t, y: y[0] - 1.0, jump=lambda t, y: [y[0] - 1.0, 1.0]),
        )  # fmt: skip
        bars = cg.plot.timeline(run, mode=1).collections[:-1]
        spans = [np.unique(b.get_paths()[0].vertices[:, 0]).tolist() for b in bars]
        np.testing.assert_allclose(spans, [[-1.5, 0.0], [-3.0, -1.5]])


class TestPhasePlane:
    def test_is_drawn_between_steps_and_cut_at_jumps(self):
        run = bouncing(dense_output=True)
        ax = cg.plot.phase_plane(run, 0, 1, label="ball", names=("height (m)", "speed (m/s)"))
        curve, *jumps = ax.lines[: 1 + len(run.t_events[0])]
        x, v = curve.get_data()
        energies = 9.81 * x + v**2 / 2
        cuts = np.flatnonzero(np.isnan(x))
        assert len(cuts) == len(run.t_events[0]) == len(jumps) >= 2
        first = energies[: cuts[0]]
        np.testing.assert_allclose(first, 9.81, rtol=1e-8)
        np.testing.assert_allclose(energies[cuts[0] + 1 : cuts[1]], 9.81 / 4, rtol=1e-8)
        assert np.hypot(np.diff(x), np.diff(v) / 5)[: cuts[0] - 1].max() < 0.02
        for k, jump in enumerate(jumps):
            ends = run.y_events[0][k], run.y_after[0][k]
            np.testing.assert_array_equal(jump.get_xydata(), ends)
            assert jump.get_linestyle() == ":"
        start, end = ax.lines[-2:]
        np.testing.assert_array_equal(start.get_xydata(), [run.y[0]])
        np.testing.assert_allclose(end.get_xydata(), [run.y[-1]], atol=1e-12)
        assert start.get_marker() != end.get_marker()
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("height (m)", "speed (m/s)")

    def test_without_dense_output_has_the_stored_points(self):
        run = bouncing(end=0.4)
        ax = cg.plot.phase_plane(run, 1, height_of)
        np.testing.assert_array_equal(ax.lines[0].get_xydata(), run.y[:, ::-1])
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("y[1]", "height_of")

    def test_jumps_at_one_time(self):
        """In the order of the list, each from where the one before has led."""
        at = lambda t, y: t - 1.0
        kicks = [cg.Event(at, jump=lambda t, y, k=k: y + k) for k in (1.0, 2.0)]
        run = cg.solve_ivp(
            lambda t, y: [1.0, 0.0], (0, 2), [0.0, 0.0], frame=PLANE, events=kicks,
            dense_output=True,
        )  # fmt: skip
        one, two = (line.get_xydata() for line in cg.plot.phase_plane(run, 0, 1).lines[1:3])
        np.testing.assert_allclose(one, [[1, 0], [2, 1]])
        np.testing.assert_allclose(two, [[2, 1], [4, 3]])

    def test_members_that_succeeded(self):
        runs = swings(dense_output=True)
        assert runs.status.tolist() == [0, 0, -1]
        ax = cg.plot.phase_plane(runs, 0, 1, label="members")
        curves = [line for line in ax.lines if len(line.get_xdata()) > 100]
        assert [curve.get_xdata()[0] for curve in curves] == [1.0, 2.0]
        assert len({curve.get_color() for curve in curves}) == 1
        cg.plot.phase_plane(runs[1], 0, 1, ax, label="one")
        assert [text.get_text() for text in ax.get_legend().get_texts()] == ["members", "one"]
        last = [line for line in ax.lines if len(line.get_xdata()) > 100][-1]
        assert last.get_color() != curves[0].get_color()
        assert last.get_linestyle() != curves[0].get_linestyle()

    def test_entries_of_matrices(self):
        run = cg.integrate(
            lambda t, y: [0.0, 0.0, 1.0], (0, 1), np.eye(3), frame=cg.frames.SO3(), h=0.25
        )
        ax = cg.plot.phase_plane(run, (0, 0), (-1, 2))
        np.testing.assert_array_equal(ax.lines[0].get_xydata(), run.y[:, [0, 2], [0, 2]])
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("y[0, 0]", "y[-1, 2]")


def height_of(y):
    return y[:, 0]


def test_bad_arguments_are_named():
    run, runs = bouncing(), swings()
    bad = [
        (cg.plot.timeline, "solution", [[run.y], [runs], [runs[0]]]),
        (cg.plot.timeline, "events", [[run, None, {"events": "one"}]]),
        (cg.plot.timeline, "mode", [
            [run, None, {"mode": mode}] for mode in (2, (0, 0), 0, "height", lambda y: y)
        ]),
        (cg.plot.timeline, "ax", [[run, 3]]),
        (cg.plot.phase_plane, "solution", [[run.y, 0, 1]]),
        (cg.plot.phase_plane, "x", [[run, x, 1] for x in (2, (0, 1), 0.5, lambda y: 1j * y[:, 0])]),
        (cg.plot.phase_plane, "y", [[run, 0, y] for y in (2, None, lambda y: y[0])]),
        (cg.plot.phase_plane, "names", [
            [run, 0, 1, None, {"names": names}] for names in ("ab", ["a"], ["a", 1])
        ]),
    ]  # fmt: skip
    for function, name, calls in bad:
        for call in calls:
            options = call.pop() if isinstance(call[-1], dict) else {}
            refuses((TypeError, ValueError), rf"^{name}\b", function, *call, **options)
    assert not plt.get_fignums()
    observed = bouncing(observe=lambda t, y: y[0], store="observed")
    refuses(ValueError, "solution must have points", cg.plot.timeline, observed)
    refuses(ValueError, r"solution must be of one member.*got Ens", cg.plot.timeline, runs)
    refuses(ValueError, "solution must have events, got Solution", cg.plot.timeline, runs[0])
    refuses(ValueError, "for each of several points, got", cg.plot.phase_plane, run, 0, np.sum)
