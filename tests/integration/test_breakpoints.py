"""Breakpoints: steps end there, and each step uses f on its own side."""

import warnings

import numpy as np
import pytest

import cg
from cg.frames import SO3


def test_warning_for_kinks_without_breakpoints():
    """The data are interpolated linearly."""
    times = np.linspace(0.0, 1.0, 1001)
    rates = np.random.default_rng(1).standard_normal((3, len(times)))

    f = lambda t, y: [np.interp(t, times, row) for row in rates]
    options = {"frame": SO3(), "method": "RKMK8(5,3)", "rtol": 1e-11, "atol": 1e-11}
    with pytest.warns(UserWarning, match="name them as breakpoints") as caught:
        poor = cg.solve_ivp(f, (0, 1), np.eye(3), **options)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        good = cg.solve_ivp(f, (0, 1), np.eye(3), breakpoints=times, **options)
    assert good.nrejected == 0
    assert good.nfev < 0.5 * poor.nfev
    assert np.isin(times, good.t).all()
