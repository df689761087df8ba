"""Points without weights and equal points do not change steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from other_paths import as_they_are

import cg
from cg.construction.points import START, Point
from cg.frames import SO3, Euclidean, Product, Sphere, Stiefel, UnitQuaternion

pytestmark = pytest.mark.sanitize

FRAMES = [SO3(), UnitQuaternion(), Sphere(2), Product(SO3(), Euclidean(2)), Stiefel(3, 2)]
NAMES = ["CF3", "CF4", "CG3", "BS3(2)", "CG2(3)"]


def f_of(frame):
    weights = np.random.default_rng(3).standard_normal((frame.dim, np.prod(frame.point_shape)))
    return lambda t, y: np.cos(t) + weights @ y.ravel()


def with_idle_points(method, choose):
    """Return the method with additional points that do not change its steps."""
    points, place = [], {START: START}
    for index, point in enumerate(method.points):
        parent = place[point.parent]
        for _ in range(choose(0, 2)):
            points.append(Point(parent, {0: 0} if choose(0, 1) else {}))
            if choose(0, 1):
                parent = len(points) - 1
        for _ in range(choose(0, 1)):
            points.append(Point(parent, point.weights))  # that nothing starts from
        points.append(Point(parent, point.weights))
        place[index] = len(points) - 1
        for _ in range(choose(0, 1)):
            points.append(Point(place[index], {}))
            place[index] = len(points) - 1
    stages = [place[point] for point in method.stage_points]
    embedded = None if method.embedded_result is None else place[method.embedded_result]
    return cg.CommutatorFree(points, stages, place[method.result], embedded_result=embedded)


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_idle_points_do_not_change_steps(frame, name, data):
    method = cg.methods[name]
    padded = with_idle_points(method, lambda low, high: data.draw(st.integers(low, high)))
    y0 = frame.random_point(np.random.default_rng(1))
    ways = [{"h": 0.125}] + ([{"rtol": 1e-4}] if method.embedded_order else [])
    for way in ways:
        runs = [
            cg.solve_ivp(f_of(frame), (0, 1), y0, frame=frame, method=one, t_eval=[0.3, 1.0], **way)
            for one in (as_they_are(method), padded)
        ]
        np.testing.assert_array_equal(runs[1].y, runs[0].y)
        assert (runs[1].nfev, runs[1].nexp) == (runs[0].nfev, runs[0].nexp)
    assert (padded.order, padded.exponentials) == (method.order, method.exponentials)


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_stage_shares_points_of_a_flow(frame):
    """A stage at a point without weights is a stage at the initial point."""
    idle = cg.CommutatorFree([(START, {}), (START, {0: "1/2", 1: "1/2"})], [START, 0], 1)
    simple = cg.CommutatorFree([(START, {0: "1/2", 1: "1/2"})], [START, START], 0)
    y0 = frame.random_point(np.random.default_rng(1))
    runs = [
        cg.integrate(f_of(frame), (0, 1), y0, frame=frame, method=one, h=0.25)
        for one in (idle, simple)
    ]
    np.testing.assert_array_equal(runs[0].y, runs[1].y)


def test_three_stages_at_the_start_have_room_for_those_of_the_step_before():
    """Compiled code keeps them of any explicit method, and copies them into a state."""
    method = cg.CommutatorFree([(START, {0: "1/2", 1: "1/4", 2: "1/4"})], [START] * 3)
    tableau = cg.Tableau([[0, 0, 0]] * 3, ["1/2", "1/4", "1/4"])
    assert [one.table().kept_nodes for one in (method, cg.MuntheKaas(tableau))] == [3, 3]
    assert cg.methods["CF3"].table().kept_nodes == 0
