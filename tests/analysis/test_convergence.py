"""Slopes of errors against step sizes."""

import numpy as np
import pytest

from cg.analysis.convergence import observed_order, slopes


def test_slope_of_exact_powers():
    h = np.array([0.05, 0.4, 0.1, 0.2])
    assert observed_order(h, 3.0 * h**4) == pytest.approx(4.0)
    np.testing.assert_allclose(slopes(h, h**2.5), 2.5)


def test_asymptotic_range_leaves_out_coarse_steps_and_rounding():
    h = np.array([1.0, 0.5, 0.25, 0.125, 0.0625])
    errors = np.array([3.0, 0.25, 0.0625, 0.015625, 1e-16])
    assert observed_order(h, errors, floor=1e-15, h_range=(0.0, 0.5)) == pytest.approx(2.0)
    assert observed_order(h, errors, h_range=(0.1, 0.5)) == pytest.approx(2.0)
    assert observed_order(h[:4], errors[:4]) > 2.2


@pytest.mark.parametrize(("h", "errors", "changes", "message"), [
    ([0.1, 0.2], [1.0], {}, "must be vectors of one length"),
    ([[0.1, 0.2]], [[1.0, 2.0]], {}, "must be vectors of one length"),
    ([0.1, 0.2], [1.0, np.nan], {}, "errors must be positive and finite"),
    ([0.1, 0.2], [1.0, np.inf], {}, "errors must be positive and finite"),
    ([0.1, -0.2], [1.0, 2.0], {"h_range": (-1.0, 1.0)}, "h must be positive and finite"),
    ([0.1, 0.1], [1.0, 2.0], {}, "h must be distinct"),
    ([0.1, 0.2], [1e-17, 1.0], {"floor": 1e-15}, "errors must leave two points"),
    ([0.1, 0.2], [1.0, 2.0], {"h_range": (0.15, 1.0)}, "errors must leave two points"),
])  # fmt: skip
def test_bad_errors_are_refused(h, errors, changes, message):
    with pytest.raises(ValueError, match=message):
        observed_order(h, errors, **changes)
