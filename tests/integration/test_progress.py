"""Progress of integrations, and results as datasets of xarray."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cg
from cg.integration.run import drive

FRAME = cg.frames.SO3()


class Reports(list):
    def __call__(self, done, total):
        self.append((done, total))


@pytest.fixture
def reports(monkeypatch):
    monkeypatch.setattr(drive, "_REPORT_SECONDS", 0.0)
    return Reports()


def turn(t, y):
    return [0.1, 0.2, np.cos(t)]


def check(reports, total, end=None):
    done = [entry for entry, _ in reports]
    assert {entry for _, entry in reports} == {total}
    assert done == sorted(done)
    assert done[-1] == (total if end is None else pytest.approx(end, abs=1e-14))


class TestProgress:
    @pytest.mark.parametrize("options", [{}, {"h": 0.1}, {"t_eval": [1.0, 2.0]}])
    def test_of_solve_ivp(self, reports, options):
        cg.solve_ivp(
            turn, (-1, 2), np.eye(3), frame=FRAME, progress=reports, method="DP5(4)", **options
        )
        check(reports, 3.0)

    def test_of_integrations_that_end_early(self, reports):
        event = lambda t, y: t - 1.25
        event.terminal = True
        run = cg.solve_ivp(
            turn, (0, 3), np.eye(3), frame=FRAME, events=event, max_step=0.5, progress=reports
        )
        assert run.status == 1
        assert reports[-1][0] < 3.0
        check(reports, 3.0, reports[-1][0])

    def test_seldom_and_at_the_end(self):
        reports = Reports()
        cg.integrate(turn, (0, 3), np.eye(3), frame=FRAME, method="CG3", h=0.01, progress=reports)
        assert reports[-1] == (3.0, 3.0)
        assert len(reports) < 100

    def test_its_errors_are_errors(self, reports):
        def stop(done, total):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            cg.integrate(turn, (0, 3), np.eye(3), frame=FRAME, method="CG3", h=0.1, progress=stop)


class TestDatasets:
    @pytest.fixture(autouse=True)
    def _xarray(self):
        pytest.importorskip("xarray")

    def test_of_matrices(self):
        run = cg.integrate(turn, (0, 1), np.eye(3), frame=FRAME, method="CG3", h=0.25)
        data = run.to_xarray()
        assert data.y.dims == ("t", "row", "column")
        assert_array_equal(data.y, run.y)
        assert_array_equal(data.t, run.t)
        assert data.attrs == {
            "method": "CG3", "frame": "SO3()", "nfev": 12, "njev": 0, "nlu": 0, "nexp": 24,
            "steps": 4, "nrejected": 0, "status": 0, "message": run.message, "h": 0.25,
        }  # fmt: skip
        assert_array_equal(data.y.sel(t=0.5), run.y[2])
