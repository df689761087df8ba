"""Frames in JAX equal those in NumPy and are differentiable."""

import warnings

import numpy as np
import pytest
from jax_problems import squeeze
from jax_setup import jax
from refusals import refuses
from slow_cases import slow

import cg
from cg import frames as fr
from cg.jax.frames import rules_of

jnp = jax.numpy


QUICK = [fr.UnitQuaternion(), fr.Euclidean(3)]
FRAMES = [
    fr.SE3(), fr.SU(2), fr.Sphere(2), fr.Stiefel(3, 2), fr.Product(fr.SU(2), fr.Euclidean(2)),
    squeeze(bracket=lambda u, v: np.zeros(2)), fr.SPD(2), fr.Hyperbolic(3),
]  # fmt: skip
OTHERS = [
    fr.UnitQuaternion("space", scalar_first=True), fr.SO3("space"), fr.SO3(), fr.SE3("space"),
    fr.SO(2), fr.SO(4), fr.SU(3), fr.SU(2, "body"), fr.U(2), fr.GL(2), fr.SL(3, "body"),
    fr.Semidirect(fr.SO3(), 2), fr.Sp(4), fr.Sphere(1), fr.Sphere(3), fr.Stiefel(4, 2),
    fr.Grassmann(4, 2), fr.IsospectralOrbit((1.0, 2.0, 4.0)), fr.Power(fr.Sphere(2), 3),
    fr.IsospectralOrbit((0.0, 0.0, 1.0), hermitian=True),
    fr.MatrixFrame([[[0.0, -0.5], [2.0, 0.0]]]),
]  # fmt: skip
EPS = np.finfo(float).eps


@pytest.fixture(params=[*QUICK, *FRAMES, *slow(*OTHERS)], ids=repr)
def frame(request):
    return request.param


@pytest.fixture
def example(frame):
    """A point, and coefficients whose flows take less than half a turn."""
    rng = np.random.default_rng(5)
    return frame.random_point(rng), *(0.7 * rng.standard_normal((2, frame.dim)))


def close(one, other, factor=1.0):
    np.testing.assert_allclose(one, other, rtol=0.0, atol=200 * factor * EPS)


class TestValues:
    def test_flows_and_fields(self, frame, example):
        y, v, w = example
        rules = rules_of(frame)
        actual = jax.jit(lambda v, w, y: (rules.restore(rules.flow(v, y)), rules.field(w, y)))
        moved, tangent = actual(v, w, y)
        close(moved, frame.flow(v, y))
        close(tangent, frame.field(w, y))

    def test_coefficients_sizes_and_dexpinv(self, frame, example):
        y, v, w = example
        rules = rules_of(frame)
        end, tangent, near = frame.flow(v, y), frame.field(w, y), frame.flow(1e-6 * w, y)

        @jax.jit
        def compute(v, w, y, end, tangent):
            back = rules.field(rules.coefficients(y, tangent), y)
            known = () if rules.log is None else (rules.log(y, end),)
            nearest, step = rules.coefficients(y, tilt), rules.local_coordinates(y, near)
            return back, nearest, rules.sizes(y), rules.dexpinv(v, w, 8), step, *known

        tilt = np.random.default_rng(8).standard_normal(y.shape)
        back, nearest, sizes, derivative, step, *known = compute(v, w, y, end, tangent)
        close(back, tangent, 10)
        with warnings.catch_warnings(action="ignore"):
            close(nearest, frame.coefficients(y, tilt), 10)
        close(sizes, frame.coordinate_sizes(y))
        close(derivative, frame.dexpinv(v, w, order=8), 10)
        close(frame.flow(step, y), near)
        for actual in known:
            close(actual, frame.exp_coordinates(y, end), 10)

    def test_relative_errors(self, frame, example):
        """They are those of NumPy to first order; a step of Newton's method removes them."""
        y, *_ = example
        rules = rules_of(frame)
        error = jax.jit(rules.relative_error)
        assert max(error(y), error(frame.flow(np.full(frame.dim, 2.0), y))) < 1e-14
        rng = np.random.default_rng(6)
        tilt = rng.standard_normal(y.shape) + (1j if np.iscomplexobj(y) else 0.0)
        exact = frame.relative_error(y + 1e-6 * tilt)
        assert 0.3 * exact <= error(y + 1e-6 * tilt) <= 3.0 * exact
        if exact == 0.0:
            return
        if not isinstance(frame, (fr.SL, fr.Sp, fr.SPD)):  # open, or relative
            assert min(error(2.0 * y), error(0.0 * y)) >= 0.5
        if isinstance(frame, fr.Semidirect):
            tilt[-1 - (frame.size - frame.group.size) :] = 0.0
        restored = jax.jit(rules.restore)(y + 1e-6 * tilt)
        assert frame.membership_error(restored) < 1e-10


def test_reflections_are_off_the_rotations():
    assert rules_of(fr.SO3()).relative_error(-jnp.eye(3)) == pytest.approx(2.0, abs=1e-14)
    assert rules_of(fr.Hyperbolic(2)).relative_error(jnp.array([3.0, -1.0])) == 2.0


def test_coefficients_between_points_of_symmetric_matrices():
    frame, rng = fr.SPD(2), np.random.default_rng(3)
    y = frame.random_point(rng)
    end = frame.flow(0.1 * rng.standard_normal(frame.dim), y)
    moved = frame.flow(np.asarray(jax.jit(rules_of(frame).local_coordinates)(y, end)), y)
    np.testing.assert_allclose(moved, end, rtol=1e-13)


def unitary(frame, angles, rng):
    """Return a random element of a group of unitary matrices whose eigenvalues have some angles."""
    if isinstance(frame, fr.SO):
        axes = frame.random_point(rng)
        x = np.eye(frame.n)
        for i, angle in enumerate(angles):
            c, s = np.cos(angle), np.sin(angle)
            x[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[c, -s], [s, c]]
    else:
        axes, x = fr.U(frame.n).random_point(rng), np.diag(np.exp(1j * np.asarray(angles)))
    return axes @ x @ axes.conj().T


UNITARY = [fr.SO(4), fr.SU(3), *slow(fr.SO(5, "space"), fr.SO(7), fr.U(1), fr.U(2))]


@pytest.mark.parametrize("kind", [np.float64, np.float32])
class TestLargeAngles:
    @pytest.mark.parametrize(
        "frame", [*UNITARY, *slow(fr.Stiefel(4, 2), fr.Sphere(3), fr.GL(2))], ids=repr
    )
    def test_flows(self, frame, kind):
        rng = np.random.default_rng(3)
        flow = jax.jit(lambda v, y: cg.jax.flow(frame, v, y))
        for size in (8.0, 11.0, 30.0, 1000.0)[: 1 if isinstance(frame, fr.GL) else 4]:
            for _ in range(5):
                y, v = frame.random_point(rng), rng.standard_normal(frame.dim)
                v = (size / np.linalg.norm(v) * v).astype(kind)
                y = y.astype(np.result_type(kind, np.complex64) if np.iscomplexobj(y) else kind)
                end = frame.flow(v, y)
                atol = 20 * size * np.finfo(kind).eps * np.abs(end).max()
                np.testing.assert_allclose(flow(v, y), end, rtol=0.0, atol=atol)

    @pytest.mark.parametrize("frame", UNITARY, ids=repr)
    def test_logarithms(self, frame, kind):
        """They lead to the point, are shortest, and have right derivatives along themselves."""
        rng, rounding = np.random.default_rng(4), float(np.finfo(kind).eps)
        rules, count = rules_of(frame), frame.n // 2 if isinstance(frame, fr.SO) else frame.n
        log = jax.jit(rules.log)

        def along(v, y):
            return jax.grad(lambda s: (rules.log(y, rules.flow(s * v, y)) ** 2).sum())(1.0)

        along = jax.jit(along)
        for less in (0.0, 1e-13, 1e-9, 1e-6, 1e-3, 0.1, 1.0):
            for other in (0.0, 0.5 * np.pi, 2.5, -3.0):
                angles = [np.pi - less, other, *[1.0] * count][:count]
                if isinstance(frame, fr.SU):
                    angles[-1] = -sum(angles[:-1])
                x, one = unitary(frame, angles, rng), np.eye(frame.n, dtype=frame.dtype)
                low = np.complex64 if frame.dtype.kind == "c" else np.float32
                one, x = (y.astype(low if kind == np.float32 else frame.dtype) for y in (one, x))
                v = np.asarray(log(one, x))
                assert v.dtype == kind
                np.testing.assert_allclose(frame.flow(v, one), x, rtol=0.0, atol=50 * rounding)
                shortest = np.linalg.norm(frame.exp_coordinates(one, x))
                assert np.linalg.norm(v) == pytest.approx(shortest, abs=100 * rounding)
                slope = along((1.0 - 1e-3) * v, one)
                expected = 2.0 * (1.0 - 1e-3) ** 2 * shortest**2
                assert slope == pytest.approx(expected, rel=200 * rounding)

    @pytest.mark.parametrize("frame", [fr.UnitQuaternion(), fr.SU(2)], ids=repr)
    def test_a_full_turn_of_quaternions(self, frame, kind):
        y = np.eye(2) + 0j if isinstance(frame, fr.SU) else np.array([0.0, 0.0, 0.0, 1.0])
        y = y.astype(np.result_type(kind, np.complex64) if np.iscomplexobj(y) else kind)
        log = rules_of(frame).log
        along = jax.jit(jax.value_and_grad(lambda s: log(y, s * y)[0]))
        value, slope = along(-1.0)
        assert value == pytest.approx(2.0 * np.pi, rel=1e-6)
        assert np.isfinite(slope)


class TestSeriesOfDexpinv:
    """Beyond the radius of convergence values are those of NumPy: NaN, unless the series ends."""

    @pytest.mark.parametrize(
        "frame", [fr.SU(3), fr.SO3(), fr.SE3(), *slow(fr.SO(4), fr.SU(2))], ids=repr
    )
    def test_the_radius(self, frame):
        """It is where differences of eigenvalues of the matrix of u are 2 π."""
        rng = np.random.default_rng(10)
        u, v = rng.standard_normal((2, 8, frame.dim))
        adjoint = np.array([frame.bracket(u, unit) for unit in np.eye(frame.dim)])
        rates = np.abs(np.linalg.eigvals(adjoint.swapaxes(0, 1))).max(axis=-1)
        dexpinv = jax.jit(jax.vmap(lambda u, v: rules_of(frame).dexpinv(u, v, 6)))
        for turns, exists in ((0.9, True), (0.97, True), (1.03, False), (1.1, False)):
            scaled = turns * 2.0 * np.pi * u / rates[:, None]
            values, expected = dexpinv(scaled, v), frame.dexpinv(scaled, v, order=6)
            np.testing.assert_allclose(values, expected, rtol=2e-13)
            if frame.dim == 3:
                assert (np.isfinite(values) == exists).all()
        assert np.isnan(values).all()

    @pytest.mark.parametrize("frame", [fr.SO3(), fr.SE3()], ids=repr)
    def test_rounding_is_not_amplified_near_the_radius(self, frame):
        v = np.resize([0.7, -0.2, 0.55, 0.3, 0.2, 0.1], frame.dim)
        dexpinv = lambda u: rules_of(frame).dexpinv(u, v, 6)
        u = (1.0 - 1e-9) * 2.0 * np.pi / np.linalg.norm(v[:3]) * v
        assert np.abs(jax.jit(dexpinv)(np.nextafter(u, 9.0)) - v).max() < 1e-15
        u = 0.8 * u
        by_v = jax.jit(jax.jacfwd(lambda v: rules_of(frame).dexpinv(u, v, 6)))
        np.testing.assert_allclose(by_v(v), by_v(np.cos(u)), atol=1e-14)  # linear in v
        slope = jax.jit(jax.jacfwd(dexpinv))(u)
        steps = [dexpinv(u + 1e-6 * unit) - dexpinv(u - 1e-6 * unit) for unit in np.eye(len(u))]
        np.testing.assert_allclose(slope.T, np.array(steps) / 2e-6, atol=1e-8)

    def test_derivatives_stay_finite(self):
        frame = fr.SU(3)
        v = np.random.default_rng(12).standard_normal(frame.dim)
        slope = jax.jit(jax.jacrev(lambda u: rules_of(frame).dexpinv(u, v, 6)))
        for u in (0.0 * v, 0.1 * v[::-1]):
            forward = jax.jacfwd(lambda u: rules_of(frame).dexpinv(u, v, 6))(u)
            close(slope(u), forward, 10)
            assert np.isfinite(forward).all()
        assert np.isfinite(slope(8.0 * v)).all()


@pytest.mark.parametrize("frame", [*QUICK, *slow(*FRAMES, *OTHERS)], ids=repr, indirect=True)
class TestDerivatives:
    def test_logarithms_at_equal_points(self, frame, example):
        y, v, _ = example
        rules = rules_of(frame)
        if rules.log is None:
            pytest.skip("no coordinates")

        back = lambda v: rules.log(y, rules.flow(v, y))
        shortest = jax.jit(lambda v: rules.coefficients(y, rules.field(v, y)))(v)
        first, second = jax.jit(
            lambda u, w: (jax.jvp(back, (u,), (w,))[1], jax.jvp(jax.jacrev(back), (u,), (w,))[1])
        )(0.0 * v, v)
        close(first, shortest, 50)
        if rules.unique:
            close(second, np.zeros((frame.dim, frame.dim)), 200)


def test_products_are_taken_apart_and_joined():
    frame = fr.Product(fr.SU(2), fr.UnitQuaternion(), fr.Euclidean(2))
    y = frame.random_point(np.random.default_rng(1))
    parts = cg.jax.split(frame, y)
    for part, expected in zip(parts, frame.split(y), strict=True):
        np.testing.assert_array_equal(part, expected)
    np.testing.assert_array_equal(cg.jax.join(frame, *parts), y)
    refuses(ValueError, "parts must", cg.jax.join, frame, np.zeros(4))
    refuses(ValueError, r"parts\[1\] must", cg.jax.join, frame, np.eye(2), np.zeros(3), np.zeros(2))


def test_bad_input():
    quaternion = fr.UnitQuaternion()
    refuses(ValueError, "y must", cg.jax.flow, quaternion, np.zeros(3), np.zeros(3))
    refuses(ValueError, "v must", cg.jax.flow, quaternion, np.zeros(4), np.zeros(4))
    with pytest.raises(ValueError, match=r"must have exp_coordinates"):
        cg.jax.log(fr.Stiefel(3, 2), np.eye(3, 2), np.eye(3, 2))
    refuses(TypeError, "frame must", cg.jax.split, quaternion, np.zeros(4))
    refuses(TypeError, "frame must", rules_of, 3)
    orbit = fr.CoadjointOrbit(fr.SO3(), [1.0, 0.0, 0.0])
    refuses(TypeError, r"FieldFrame takes a flow in jax.numpy", rules_of, orbit)
