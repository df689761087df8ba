"""What several threads and processes do at once in `test_together.py`."""

import numpy as np

import cg

TASKS = 16


def task(k: int) -> object:
    """Return what the k-th task gives; the same on any thread of any process."""
    kind = k % 4
    if kind == 0:
        actual = cg.search(3, 3, 6, seed=k, workers=1)
        return [(start.double, start.quad, start.x, start.exact) for start in actual.starts]
    if kind == 1:
        built = cg.construct(4, 4, seed=k, tries=2, workers=1, force=True)
        return built.exact, str(built.method.exact) if built.exact else None
    if kind == 2:
        frame = cg.frames.SO3()
        rates = np.array([0.3, -0.2, 0.1 * k])
        actual = cg.solve_ivp(lambda t, y: rates * np.cos(t), (0, 2), np.eye(3), frame=frame)
        return actual.t.tobytes(), actual.y.tobytes()
    certificate = cg.certify(("CG3", "CF3", "CF4", "CG4a")[k // 4 % 4])
    return certificate, cg.conditions.residuals(np.tri(5, k=-1) / 3, np.full(5, 0.2), 6).tobytes()
