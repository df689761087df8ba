"""The minimum-norm solver against the same algorithm in NumPy."""

import numpy as np
import pytest

from cg import conditions
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.system import ConditionSystem
from cg.structure.layout import Layout

ORDER, STAGES = 4, 5
PROBE, MAX_BEND = 0.1, 0.75
LEAST = {False: 1e-17, True: 1e-22}


def reference(x, layout, first_damping, iterations, accurate):
    """Return x, f and the number of rejected steps after a number of iterations."""

    def residual(x):
        return conditions.residuals(layout, x, ORDER, independent=True)

    def jacobian(x):
        return conditions.jacobian(layout, x, ORDER, independent=True)

    r, jac = residual(x), jacobian(x)
    f, refused, growth = r @ r, 0, 2.0
    damping = max(first_damping * (jac**2).sum(axis=1).max(), LEAST[accurate])
    for _ in range(iterations):
        matrix = jac @ jac.T + damping * np.eye(r.size)
        y = np.linalg.solve(matrix, r)
        step = -y @ jac
        second = 2 / PROBE * ((residual(x + PROBE * step) - r) / PROBE - jac @ step)
        acceleration = -np.linalg.solve(matrix, second) @ jac
        if np.linalg.norm(acceleration) <= MAX_BEND * np.linalg.norm(step):
            step = step + acceleration / 2
        trial = residual(x + step)
        if trial @ trial < f:
            gain = (f - trial @ trial) / (f - damping**2 * (y @ y))
            damping = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), LEAST[accurate])
            growth, x, r, f = 2.0, x + step, trial, trial @ trial
            jac = jacobian(x)
        else:
            damping, growth, refused = damping * growth, 2 * growth, refused + 1
    return x, f, refused


@pytest.mark.parametrize("accurate", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_iterations_equal_reference_algorithm(seed, accurate):
    layout = Layout.tableau(STAGES)
    system = ConditionSystem(ORDER, layout)
    start = np.random.default_rng(seed).uniform(-1, 1, layout.size)
    for iterations in (0, 1, 2, 5, 9):
        x, f, _ = reference(start, layout, 1e-2, iterations, accurate)
        fit = fit_conditions(start, system, max_iterations=iterations, accurate=accurate)
        assert fit.iterations == iterations
        assert fit.evaluations == 1 + 2 * iterations
        # Rounding is magnified by the condition numbers of the matrices.
        np.testing.assert_allclose(fit.x, x, rtol=0, atol=1e-9)
        assert fit.f == pytest.approx(f, rel=1e-8)
