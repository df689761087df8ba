"""The example scripts of the gallery: invariants, the manifold, and an exact solution."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import cg

GALLERY = Path(__file__).resolve().parents[2] / "docs/gallery"


def load(name):
    """Return an example script as a module."""
    spec = importlib.util.spec_from_file_location(name, GALLERY / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["body_with_pendulum", "double_pendulum", "rolling_ball"])
def test_examples_conserve_their_invariants(name):
    example = load(name)
    solution = cg.solve_ivp(
        example.f, (0, 2), example.y0, frame=example.frame, rtol=1e-10, atol=1e-10
    )
    assert example.frame.membership_error(solution.y).max() < 1e-14
    start = example.invariants(example.y0)
    for key, values in example.invariants(solution.y).items():
        np.testing.assert_allclose(values - start[key], 0.0, atol=1e-8, err_msg=key)


def test_rolling_ball_moves_on_the_exact_circle():
    ball = load("rolling_ball")
    solution = cg.solve_ivp(ball.f, (0, 5), ball.y0, frame=ball.frame, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(solution.y[:, 12:], ball.exact_position(solution.t), atol=1e-8)
