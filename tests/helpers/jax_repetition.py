"""Print by how much gradients of repeated and of stored steps by a method differ."""

import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import cg

jax.config.update("jax_enable_x64", True)
FRAME = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
START = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 2.0, -0.5])
STEPS = 1024


def coefficients(t, y, inertia):
    return jnp.concatenate([y[4:], jnp.cross(inertia * y[4:], y[4:]) / inertia])


def gradient(checkpoints):
    """Return the derivative of an attitude by the moments of inertia."""

    def end(inertia):
        solution = diffrax.diffeqsolve(
            cg.jax.FrameTerm(coefficients, FRAME),
            cg.jax.Solver(sys.argv[1], dense="steps"),
            t0=0.0,
            t1=10.0,
            dt0=0.01,
            y0=START,
            args=inertia,
            stepsize_controller=cg.jax.controller(FRAME, 1e-9, 1e-9),
            max_steps=STEPS,
            adjoint=diffrax.RecursiveCheckpointAdjoint(checkpoints=checkpoints),
        )
        return solution.ys[-1, 0]

    return jax.jit(jax.grad(end))(jnp.array([1.0, 2.0, 2.5]))


if __name__ == "__main__":
    print(float(jnp.abs(gradient(5) - gradient(STEPS)).max()))
