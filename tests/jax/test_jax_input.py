"""Wrong points, functions, tolerances and names of methods in JAX."""

import re
from pathlib import Path

import numpy as np
import pytest
from jax_problems import point, solve, term
from jax_setup import jax

import cg
from cg.frames import SE3, SO3, SU, Euclidean, Power, Product, Sphere, Stiefel, UnitQuaternion
from cg.jax.frames import _MAKERS
from cg.jax.points import membership_error

jnp = jax.numpy
FRAMES = [
    *(SO3(), SE3(), SU(2), Sphere(2), UnitQuaternion(), Stiefel(3, 2), Power(Sphere(2), 2)),
    Product(SE3(), Euclidean(6)),
]


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_membership_errors(frame):
    y = point(frame)
    assert membership_error(frame, jnp.asarray(y)) < 1e-14
    for wrong in (2.0 * y, 0.0 * y):
        assert membership_error(frame, jnp.asarray(wrong)) >= 0.5
    near = y + 1e-6 * np.random.default_rng(0).standard_normal(y.shape)
    exact = frame.membership_error(near)
    assert 0.3 * exact < membership_error(frame, jnp.asarray(near)) < 3.0 * exact


def test_reflections_are_off_the_rotations():
    assert membership_error(SO3(), -jnp.eye(3)) == pytest.approx(2.0)
    assert membership_error(SE3(), jnp.diag(jnp.array([1.0, 1.0, 1.0, 2.0]))) == pytest.approx(1.0)


def test_points_off_the_manifold():
    frame = SO3()

    def end(y0):
        return solve(term(frame)[0], cg.jax.Solver("CF3", dense="steps"), y0, h=0.5).ys[-1]

    for wrong in (
        2.0 * jnp.eye(3),
        jnp.eye(3).at[0, 1].set(1e-7),
        jnp.eye(3).at[0, 1].set(jnp.nan),
    ):
        with pytest.raises(RuntimeError, match="y0 must be within 1e-08 of the manifold of SO3"):
            jax.block_until_ready(jax.jit(end)(wrong))
    assert np.isfinite(jax.jit(end)(jnp.eye(3).at[0, 1].set(1e-9))).all()


def test_functions_of_numpy():
    def f(t, y, args):
        return np.array([np.sin(t), 0.0, 0.0])

    with pytest.raises(jax.errors.TracerArrayConversionError) as error:
        solve(cg.jax.FrameTerm(f, SO3()), cg.jax.Solver("CF4"), jnp.eye(3), h=0.1)
    assert "f must be written in jax.numpy" in error.value.__notes__[0]


def test_tolerances_below_rounding():
    frame = SO3()
    with pytest.warns(UserWarning, match="too small to be attained in float64, whose spacing is"):
        cg.jax.controller(frame, 1e-16, 1e-16)
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match="in float32.*set jax_enable_x64"):
            cg.jax.controller(frame, 1e-12, 1e-12)
        cg.jax.controller(frame, 1e-5, 1e-6)


def test_names_of_methods():
    with pytest.raises(ValueError, match=r'which has no "auto"; of the pairs "RKMK8\(5,3\)"'):
        cg.jax.Solver("auto")
    with pytest.raises(ValueError, match=r"RKMK5\(4\) and CF5\(4\) have its orders$"):
        cg.jax.Solver("Tsit5")


def test_page_of_frames_marks_those_in_jax():
    text = (Path(__file__).parents[2] / "docs" / "frames.md").read_text("utf-8")
    rows = re.findall(r"^\| `(\w+).* \|(.*)\|$", text.partition("\n\n## ")[0], re.MULTILINE)
    kinds = {kind.__name__ for kind in _MAKERS}
    assert len(rows) > 15
    assert all((name in kinds) == (mark.strip() == "yes") for name, mark in rows)
