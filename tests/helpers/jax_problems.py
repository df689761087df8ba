"""Right-hand sides and solutions for tests of `cg.jax`."""

import numpy as np
from jax_setup import diffrax, jax

import cg
from cg.frames import Euclidean, FieldFrame, Product, UnitQuaternion

jnp = jax.numpy
ATTITUDE_AND_VELOCITY = Product(UnitQuaternion(), Euclidean(3))
INERTIA = np.array([1.0, 2.0, 2.5])
START = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 2.0, -0.5])


def body(xp):
    """Return the right-hand side of a body without torques."""

    def f(t, y, inertia=INERTIA):
        velocity = y[4:]
        return xp.concatenate([velocity, xp.cross(inertia * velocity, velocity) / inertia])

    return f


def winding(frame, xp):
    """Return a right-hand side that sees time and all entries of a point."""
    rng = np.random.default_rng(0)
    count = int(np.prod(frame.point_shape))
    weights = rng.standard_normal((frame.dim, count)) / np.sqrt(count)
    phases = rng.uniform(0.0, 6.0, frame.dim)

    def f(t, y, factor=1.0):
        flat = y.reshape(-1)
        numbers = flat.real + flat.imag if frame.dtype.kind == "c" else flat
        return factor * (xp.cos(t + phases) + weights @ xp.sin(numbers))

    return f


def term(frame, f=None):
    """Return a term of a right-hand side, and the same for NumPy."""
    return cg.jax.FrameTerm(f or winding(frame, jnp), frame), winding(frame, np)


def point(frame):
    return frame.random_point(np.random.default_rng(7))


def solve(term, solver, y0, *, h=None, begin=0.0, end=1.0, rtol=1e-6, max_steps=4096, **options):
    """Return the solution of diffrax, with fixed steps or those of `cg.jax.controller`."""
    if h is None:
        options.setdefault("stepsize_controller", cg.jax.controller(term.frame, rtol, rtol))
    return diffrax.diffeqsolve(
        term, solver, begin, end, h, y0, max_steps=max_steps, **{"args": 1.0, **options}
    )


def squeeze(**options):
    """Return a frame of hyperbolic rotations in a plane and translations along an axis."""
    return FieldFrame(
        [lambda y: jnp.stack([y[0], -y[1], 0.0 * y[2]]), lambda y: jnp.array([0.0, 0.0, 1.0])],
        lambda v, y: jnp.stack([y[0] * jnp.exp(v[0]), y[1] * jnp.exp(-v[0]), y[2] + v[1]]),
        point_shape=3,
        **options,
    )
