"""The flows of a row in compiled code are those of the frame."""

import numpy as np
import pytest

import cg
from cg.frames import SE3, SO, SO3, Euclidean, Product, Sphere, UnitQuaternion
from cg.integrate.blocks import is_compiled
from cg.integrate.flows import _CompiledFlows, _Flows, flows_of

FRAMES = [
    SO3(),
    SO3("space"),
    SO(3),
    UnitQuaternion(),
    UnitQuaternion(scalar_first=True, convention="space"),
    SE3(),
    SE3("space"),
    Sphere(2),
    Euclidean(4),
    Product(SO3(), Euclidean(3), Product(Sphere(2), SE3())),
]
ROW = ((0, 0.5), (2, -1.25), (3, 0.0625))


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)], ids=repr)
@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_compiled_flows_are_the_frames(frame, batch):
    rng = np.random.default_rng(5)
    points = frame.random_point(rng, batch)
    before = points.copy()
    fields = frame.random_vector(rng, (*batch, 4))
    moved = flows_of(frame)(ROW, fields, points, 0.75)
    np.testing.assert_array_equal(points, before)
    np.testing.assert_allclose(moved, _Flows(frame)(ROW, fields, points, 0.75), rtol=0, atol=1e-14)
    assert isinstance(flows_of(frame), _CompiledFlows)
    assert frame.membership_error(moved).max() < 1e-15


def test_the_order_of_the_flows_matters():
    rng = np.random.default_rng(6)
    frame = SO3()
    y, fields = frame.random_point(rng), frame.random_vector(rng, (4,))
    flows = flows_of(frame)
    there, back = flows(ROW, fields, y, 1.0), flows(ROW[::-1], fields, y, 1.0)
    assert frame.distance(there, back) > 0.1


class Turned(SO3):
    """Another frame on the same points."""

    def flow(self, v, y):
        return super().flow(2.0 * np.asarray(v), y)


@pytest.mark.parametrize("frame", [Turned(), Product(Euclidean(1), Turned())], ids=repr)
def test_a_subclass_keeps_its_own_flow(frame):
    assert not is_compiled(frame)
    y0 = frame.random_point(np.random.default_rng(7))
    v = np.arange(1.0, frame.dim + 1)
    end = cg.integrate(lambda t, y: v, (0, 1), y0, frame=frame, method="CG3", h=1.0).y[-1]
    np.testing.assert_allclose(end, frame.flow(v, y0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("frame", [SO(4), Sphere(3), cg.frames.SU(2)], ids=repr)
def test_other_frames_are_moved_by_themselves(frame):
    assert not is_compiled(frame)
