"""What is kept of members that are integrated apart: times, ends, and the array it goes to."""

import warnings

import numpy as np
import pytest

import cg
from cg.frames import Euclidean
from cg.integration import members
from cg.runs import Finished

LINE = Euclidean(1)
KINDS = ["threads", "processes"]


def steady(t, y):
    return np.ones_like(y)


def squares(t, y):
    return y**2


def at_one(t, y):
    return y[0] - 1.0


def at_five(t, y):
    return y[0] - 5.0


at_one.terminal = at_five.terminal = True


def scaled(t, y, a, b):
    return np.stack([a + 0 * y[..., 0], b * y[..., 0]], axis=-1)


@pytest.mark.parametrize("executor", KINDS)
@pytest.mark.parametrize(
    "y0", [[0.0, 0.55, -5.0], [-0.9, -5.0], [0.05, 0.55, 0.15], [-5.0, 0.5], [0.9, 0.5]]
)
@pytest.mark.parametrize("t_eval", [None, [0.0, 0.25, 0.75, 2.0]])
def test_points_are_those_of_their_times(executor, y0, t_eval):
    """Events at times of their own end members, whose points there are in ``y_events`` alone."""
    options = {"frame": LINE, "events": at_one, "h": 0.25, "method": "CG3", "t_eval": t_eval}
    y0 = np.array(y0)[:, None]
    run = cg.solve_ivp(steady, (0, 2), y0, executor=executor, workers=1, **options)
    times = np.arange(9) / 4 if t_eval is None else np.array(t_eval)
    np.testing.assert_array_equal(run.t, times)
    wanted = y0[:, 0] + times[:, None]
    wanted[wanted > 1.0] = np.nan
    np.testing.assert_allclose(run.y[..., 0], wanted, rtol=0, atol=1e-14)
    for i, start in enumerate(y0[:, 0]):
        ends = [1.0 - start] if start > -1.0 else []
        np.testing.assert_allclose(run.t_events[0][i], ends)


def test_an_event_at_a_time_of_the_grid_is_kept():
    run = cg.solve_ivp(
        steady, (0, 2), [[0.5], [0.25]], frame=LINE, events=at_one, h=0.25, method="CG3", workers=1
    )
    wanted = [[0.5, 0.75, 1.0, np.nan, np.nan], [0.25, 0.5, 0.75, 1.0, np.nan]]
    np.testing.assert_array_equal(run.y[:5, :, 0].T, wanted)
    assert run.status == 1


def test_compiled_members_in_fixed_steps(function):
    f, numbers = function("decays"), [[-1.0, 9.0], [-2.0, 9.0]]

    def half(t, y):
        return y[0] - 0.5

    half.terminal = True
    run = cg.solve_ivp(
        f, (0, 1), np.ones((2, 1)), frame=LINE, parameters=numbers, h=0.25, method="CF4",
        events=half, workers=1,
    )  # fmt: skip
    assert run.t.tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert np.isnan(run.y[..., 0]).tolist() == [[i > 2, i > 1] for i in range(5)]


@pytest.mark.parametrize("options", [{"events": at_five}, {"max_steps": 2}])
@pytest.mark.parametrize("t_eval", [None, [0.0, 0.1, 0.85, 0.9]])
def test_times_are_those_asked_for_though_no_member_reaches_them(options, t_eval):
    y0 = [[1.0], [1.1]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = cg.solve_ivp(
            squares, (0, 0.9), y0, frame=LINE, t_eval=t_eval, rtol=1e-9, workers=1, **options
        )
    assert run.t.tolist() == ([0.0, 0.9] if t_eval is None else t_eval)
    assert np.isfinite(run.y[0]).all()
    assert np.isnan(run.y[-1]).all()
    assert run.status == (1 if "events" in options else -1)


def test_an_iterator_of_arguments():
    frame, y0 = Euclidean(2), [[1.0, 2.0], [3.0, 4.0]]
    apart = cg.solve_ivp(scaled, (0, 1), y0, frame=frame, args=iter((1.0, 2.0)), workers=1)
    again = cg.solve_ivp(scaled, (0, 1), y0, frame=frame, args=(1.0, 2.0), workers=1)
    np.testing.assert_array_equal(apart.y, again.y)


def test_one_warning_for_all_members():
    with pytest.warns(UserWarning, match="rtol") as told:
        cg.solve_ivp(steady, (0, 1), np.zeros((4, 1)), frame=LINE, rtol=0.0, workers=1)
    assert len(told) == 1


class TestOut:
    OPTIONS = {"frame": LINE, "events": at_one, "h": 0.25, "method": "CG3"}  # noqa: RUF012

    @pytest.mark.parametrize("y0", [[-5.0, 0.0, 0.5], [0.0, 0.5, -5.0]])
    @pytest.mark.parametrize("kind", [np.float64, np.float32, np.complex128])
    def test_it_is_what_is_returned_without_it(self, y0, kind):
        y0 = np.array(y0)[:, None]
        times = [0.0, 0.25, 0.75, 2.0]
        without = cg.solve_ivp(steady, (0, 2), y0, t_eval=times, workers=1, **self.OPTIONS)
        out = np.full((4, 3, 1), 777.0, dtype=kind)
        run = cg.solve_ivp(steady, (0, 2), y0, t_eval=times, out=out, **self.OPTIONS)
        assert run.y is out
        np.testing.assert_array_equal(out, without.y.astype(kind))

    def test_members_that_never_ran(self, monkeypatch):
        def killed(work, indices, total, workers, executor, *, data):
            for k in indices:
                ended = None if k == 1 else work(data([k]))
                yield Finished(k, ended, 0.0, "killed" if k == 1 else None, [k])

        monkeypatch.setattr(members, "completed", killed)
        out = np.full((2, 3, 1), 777.0)
        run = cg.solve_ivp(steady, (0, 1), np.zeros((3, 1)), frame=LINE, out=out)
        assert list(run.failures) == [(1,)]
        np.testing.assert_allclose(out[:, :, 0], [[0, np.nan, 0], [1, np.nan, 1]])

    @pytest.mark.parametrize(
        ("out", "error", "message"),
        [
            ([1], TypeError, r"out must be an array, such as one of .*, got \[1\]"),
            (np.zeros((2, 2, 1), dtype=int), ValueError, "hold numbers of type float64, got"),
            (np.zeros((2, 2, 1), dtype="S3"), ValueError, "hold numbers of type float64, got"),
            (np.zeros((3, 2, 1)), ValueError, r"out must have shape \(2, 2, 1\), got \(3, 2, 1\)"),
            (np.broadcast_to(0.0, (2, 2, 1)), ValueError, "out must be writable, got ndarray"),
        ],
    )  # fmt: skip
    def test_what_is_refused_before_anything_is_called(self, out, error, message):
        def never(t, y):
            raise AssertionError

        with pytest.raises(error, match=message):
            cg.solve_ivp(never, (0, 1), np.zeros((2, 1)), frame=LINE, out=out)

    def test_real_numbers_for_complex_points(self):
        frame = cg.frames.SU(2)
        with pytest.raises(ValueError, match="hold numbers of type complex128, got one of float64"):
            cg.solve_ivp(
                lambda t, y: [1.0, 0.0, 0.0], (0, 1), np.eye(2)[None], frame=frame,
                out=np.zeros((2, 1, 2, 2)),
            )  # fmt: skip

    def test_the_shape_is_that_of_the_times_of_fixed_steps(self):
        with pytest.raises(ValueError, match=r"out must have shape \(5, 2, 1\), got \(2, 2, 1\)"):
            cg.solve_ivp(
                steady, (0, 1), np.zeros((2, 1)), frame=LINE, h=0.25, out=np.zeros((2, 2, 1))
            )

    def test_files_that_are_read_only(self, tmp_path):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "y.h5", "w") as file:
            file.create_dataset("y", (2, 2, 1), dtype="f8")
        with (
            h5py.File(tmp_path / "y.h5", "r") as file,
            pytest.raises(ValueError, match="out must be writable, got Dataset that is read-only"),
        ):
            cg.solve_ivp(steady, (0, 1), np.zeros((2, 1)), frame=LINE, out=file["y"])


class UnusualError(Exception):
    """Can be pickled, but not unpickled."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def unusual(t, y):
    raise UnusualError("one", "two")


def test_errors_that_cannot_travel_are_told():
    """Another process that is sent one takes its worker for dead."""
    y0 = np.zeros((2, 1))
    with pytest.raises(RuntimeError, match=r"test_members_apart\.UnusualError: one and two"):
        cg.solve_ivp(unusual, (0, 1), y0, frame=LINE, executor="processes", workers=1)
    with pytest.raises(UnusualError, match="one and two"):
        cg.solve_ivp(unusual, (0, 1), y0, frame=LINE, executor="threads", workers=1)
