"""Steps in quadruple precision, against those of the package."""

import numpy as np
import pytest
from kinds import FROZEN

import cg
from cg.problems import HeavyTop
from cg.reproduce.quad_steps import end_point


@pytest.mark.parametrize("name", [name for name, method in FROZEN.items() if method.explicit])
def test_steps_agree_with_those_in_double(name):
    top = HeavyTop("velocity")
    options = {"frame": top.frame, "method": name, "h": 1 / 16}
    double = cg.integrate(top.f, (0, 1), top.y0, **options).y[-1]
    end = end_point(top, cg.methods[name], 16)
    np.testing.assert_allclose(double, [float(x) for x in end], rtol=0, atol=2e-14)


def test_rotations_are_orthogonal_to_rounding():
    method, steps = cg.methods["CG3"], 1000
    rotation = np.array(end_point(HeavyTop(), method, steps)[:9]).reshape(3, 3)
    off = abs(rotation @ rotation.T - np.eye(3, dtype=int)).max()
    # a few roundings down in each flow, which add up
    assert off < 8 * method.exponentials * steps * 2.0**-114
