"""Steps chosen by embedded pairs: error estimates, tolerances, failures."""

import numpy as np
import pytest
import scipy.integrate
from frame_examples import HEISENBERG, generic
from kinds import FROZEN, MUNTHE_KAAS
from python_steps import Step, choose_steps, error, uncompiled
from slow_cases import cases

import cg
from cg.construction.methods.compile import error_exponent
from cg.construction.methods.tableau import Tableau
from cg.frames import SE3, SO3, SU, Euclidean, Product, Sphere, Stiefel, UnitQuaternion
from cg.frames.facts import facts_of
from cg.problems import StateDependentRotation
from cg.problems.convergence import observed_order

pytestmark = pytest.mark.sanitize

PAIRS = {name: m for name, m in FROZEN.items() if m.exact_embedded is not None}
PAIRS["RKMK8(5,3)"] = MUNTHE_KAAS["RKMK8(5,3)"]
PROBLEM = StateDependentRotation()
FRAMES = [
    SO3(), SO3("space"), UnitQuaternion(), SE3(), SU(2), Sphere(2), Stiefel(3, 1),
    Product(SO3(), Euclidean(2)),
]  # fmt: skip


@pytest.fixture(scope="module")
def rotations():
    """Return the solution at 1 and 2."""
    reference = PROBLEM.reference([1, 2], bits=128)
    return reference.y[:, :9].reshape(2, 3, 3)


# a tableau; a method of points; one whose last stage is the next first; errors by combinations of
# stages, one and two
KINDS = {"CG2(3)", "CF4(3)", "DP5(4)", "CF6(5)", "DOP853", "RKMK8(5,3)"}


@pytest.mark.parametrize(
    ("frame", "name"),
    cases(FRAMES, PAIRS, quick=lambda frame, name: frame == SO3() or name in KINDS),
)
def test_error_estimate_has_the_order_of_the_embedded_method(frame, name):
    f, y0 = generic(frame, seed=3)
    step = Step(f, frame, PAIRS[name])
    order = min(PAIRS[name].order, PAIRS[name].embedded_order)
    # the largest of several: at one time alone the leading term may happen to be small
    times = (0.0, 0.3, 0.7)
    # of high orders only longer steps have estimates far above rounding
    for largest in (0.1, 0.16, 0.2, 0.3, 0.4):
        sizes = largest * np.array([1.0, 0.7, 0.5])
        errors = [max(first_estimate(step, t, y0, h) for t in times) for h in sizes]
        if min(errors) > 1e-12:
            break
    assert min(errors) > 1e-12
    assert observed_order(sizes, errors) == pytest.approx(order + 1, abs=0.35)


def first_estimate(step, t, y, h):
    """Return the first error estimate: the difference of results, or a combination of stages."""
    if step.paths.embedded:
        y1, other = step.pair(t, y, h)
        return error(step.frame, other, y1, y, 1.0, 0.0)
    return step.estimates(y, h, step(t, y, h), 1.0, 0.0)[0]


@pytest.mark.parametrize("name", list(PAIRS))
def test_error_is_proportional_to_the_tolerance(name, rotations):
    # high orders are asymptotic at small tolerances only, and low ones need many steps there
    tolerances = 10.0 ** -(np.arange(8, 12) if PAIRS[name].order > 3 else np.arange(4, 10))
    end = 1
    if PAIRS[name].order > 6:  # in half the time too few steps
        end = 2
    if PAIRS[name].order > 7:  # beyond, errors are near rounding
        tolerances = 10.0 ** -np.arange(7, 11)
    errors, steps = [], []
    for tolerance in tolerances:
        solution = cg.solve_ivp(
            PROBLEM.f, (0, end), PROBLEM.y0, frame=SO3(), method=name, rtol=tolerance,
            atol=tolerance,
        )  # fmt: skip
        errors.append(float(SO3().distance(solution.y[-1], rotations[end - 1])))
        steps.append(solution.steps)
    exponent = observed_order(tolerances, errors)
    order = 1.0 / error_exponent(PAIRS[name])  # of the estimate: that of DOP853 is of two
    assert exponent == pytest.approx(PAIRS[name].order / order, abs=0.15)
    assert (np.array(errors) < 30 * tolerances).all()
    work = observed_order(tolerances, 1.0 / np.array(steps))
    assert work == pytest.approx(1.0 / order, abs=0.08)


def test_the_default_is_chosen_by_frame_and_tolerance():
    def chosen(frame, **options):
        f, y0 = generic(frame, seed=3)
        return cg.solve_ivp(f, (0, 0.1), y0, frame=frame, **options).method.name

    for frame in (SO3(), Sphere(2), Stiefel(3, 2), Product(Sphere(3), SO3())):
        assert chosen(frame) == chosen(frame, rtol=1e-12, method="auto") == "RKMK8(5,3)"
        assert chosen(frame, h=0.05) == "CF5(4)"
        assert chosen(frame, rtol=1e-12, method="CF4(3)") == "CF4(3)"

    assert isinstance(HEISENBERG, cg.frames.FieldFrame)
    for options, name in (({}, "CF5(4)"), ({"h": 0.05}, "CF5(4)"), ({"rtol": 1e-8}, "DOP853")):
        assert chosen(HEISENBERG, **options) == name


def test_the_weights_of_higher_order_make_the_step():
    pair = cg.methods["CG2(3)"]
    swapped = Tableau(pair.entries, pair.embedded_weights, b_embedded=pair.weights)
    assert (pair.order, swapped.order, swapped.embedded_order) == (3, 2, 3)
    solutions = [
        cg.solve_ivp(PROBLEM.f, (0, 1), PROBLEM.y0, frame=SO3(), method=method)
        for method in (pair, swapped)
    ]
    np.testing.assert_array_equal(solutions[0].y, solutions[1].y)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_first_step_follows_the_time_scale(scale):
    solution = cg.solve_ivp(
        lambda t, y: PROBLEM.f(t / scale, y) / scale, (0, scale), PROBLEM.y0, frame=SO3()
    )
    first = np.diff(solution.t)[0] / scale
    assert 1e-3 < first < 0.3
    assert solution.nrejected <= 1


def test_the_first_step_is_at_most_a_hundred_guesses():
    """The guess moves the point by a hundredth of its size, which is far below the tolerance."""
    solution = cg.solve_ivp(lambda t, y: [2.0], (0, 1), [1e-9], frame=Euclidean(1), atol=1e-6)
    assert solution.t[1] == pytest.approx(100 * 0.01 * 1e-9 / 2.0, abs=1e-23)


@pytest.mark.filterwarnings("ignore:(overflow|invalid value) encountered")
def test_a_trial_step_that_overflows_is_rejected():
    # The second stage of the first step is not finite, and f isn't finite there.
    solution = cg.solve_ivp(
        lambda t, y: 1e308 / (1.0 + t) ** 4 + 0.0 * y, (0, 100), [1.0], frame=Euclidean(1),
        first_step=100.0, method="CG2(3)",
    )  # fmt: skip
    assert solution.success
    assert solution.nrejected > 0
    assert solution.y[-1, 0] == pytest.approx(1e308 / 3, rel=1e-2)


@pytest.mark.parametrize(
    ("frame", "name", "sign"),
    cases(
        [*FRAMES, uncompiled(SO3()), uncompiled(SE3())], PAIRS, [1, -1],
        quick=lambda frame, name, sign: frame is FRAMES[0] or (name in KINDS and sign == 1),
    ),
)  # fmt: skip
def test_steps_are_those_that_the_formulas_choose(frame, name, sign):
    """The sizes follow from errors in units of the tolerance, some of them above one."""
    f, y0 = generic(frame, seed=3)
    tolerance = {2: 1e-5, 3: 1e-5, 8: 1e-12}.get(PAIRS[name].order, 1e-8)
    options = {"frame": frame, "method": PAIRS[name], "rtol": tolerance, "atol": tolerance / 3}
    solution = cg.solve_ivp(f, (0.1, 0.1 + sign), y0, first_step=0.4, **options)
    expected = choose_steps(f, (0.1, 0.1 + sign), y0, first_step=0.4, **options)
    assert (solution.steps, solution.nrejected) == (len(expected.times) - 1, expected.rejected)
    assert solution.nrejected > 0
    # rounding of points is this part of an error of one tolerance, from which sizes follow
    rounding = float(np.finfo(float).eps) / tolerance
    np.testing.assert_allclose(solution.t, expected.times, rtol=0, atol=5 * rounding)
    np.testing.assert_allclose(solution.y[-1], expected.y, rtol=0, atol=2e-14)
    if PAIRS[name].explicit:
        assert (solution.nfev, solution.nexp) == (expected.nfev, expected.nexp)


def test_tolerances_of_each_coordinate_by_the_formulas():
    frame = Product(SO3(), Euclidean(2))
    f, y0 = generic(frame, seed=3)
    options = {"frame": frame, "method": PAIRS["CG2(3)"], "rtol": 1e-4, "first_step": 0.1}
    for atol in ([1e-4, 1.0, 1e-5, 1e-3, 1e-6], [0.0] * 5):
        solution = cg.solve_ivp(f, (0, 2), y0, atol=atol, **options)
        expected = choose_steps(f, (0, 2), y0, atol=np.array(atol), **options)
        np.testing.assert_allclose(solution.t, expected.times, rtol=0, atol=4e-12)


SHORT = [
    (1.7e9, 1.7e9 + 2e-6),  # eight units of the last place
    (10.0 - 5e-15, 10.0),
    (1.0, 1.0 + 2.0**-52),
    (-3.0, -3.0 - 2.0**-51),
    (1e15, 1e15 + 0.25),
]


@pytest.mark.parametrize("span", SHORT)
@pytest.mark.parametrize("frame", [Euclidean(1), Stiefel(2, 1)], ids=repr)
def test_spans_below_the_resolution_of_steps(span, frame):
    """One step leads to the end, in compiled code and in Python."""
    y0 = frame.random_point(np.random.default_rng(1))

    f = lambda t, y: [1.0]
    assert facts_of(frame).compiled is (frame == Euclidean(1))
    solution = cg.solve_ivp(f, span, y0, frame=frame)
    assert (solution.status, solution.steps, solution.nrejected) == (0, 1, 0)
    assert solution.t.tolist() == list(span)
    moved = frame.flow([span[1] - span[0]], y0)
    np.testing.assert_allclose(solution.y[-1], moved, rtol=1e-15)
    assert scipy.integrate.solve_ivp(f, span, [0.0]).status == 0


@pytest.mark.parametrize("in_c", [False, True])
def test_blow_up_ends_without_success_and_keeps_accepted_steps(in_c, compiled_function):
    f = compiled_function("square") if in_c else lambda t, y: y**2
    solution = cg.solve_ivp(f, (0, 2), [1.0], frame=Euclidean(1), dense_output=True)
    assert (solution.status, solution.success) == (-1, False)
    assert "step size fell below" in solution.message
    assert solution.t[-1] == pytest.approx(1.0, abs=1e-4)
    assert len(solution.t) == solution.steps + 1 > 20
    assert np.isfinite(solution.y).all()
    early = solution.t < 0.9
    np.testing.assert_allclose(solution.y[early, 0], 1 / (1 - solution.t[early]), rtol=1e-3)
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)
    times = np.linspace(0, 2, 8)
    chosen = cg.solve_ivp(f, (0, 2), [1.0], frame=Euclidean(1), t_eval=times)
    np.testing.assert_array_equal(chosen.t, times[:4])
    assert (chosen.y.shape, chosen.status) == ((4, 1), -1)
    for terminal, status in ((True, 1), (False, -1)):
        event = cg.Event(lambda t, y: y[0] - 100.0, terminal=terminal)
        actual = cg.solve_ivp(f, (0, 2), [1.0], frame=Euclidean(1), events=event)
        assert (actual.status, len(actual.t_events[0])) == (status, 1)
        assert actual.y_events[0] == pytest.approx(100.0, rel=2e-13)


def test_a_pair_may_advance_its_second_result():
    given = cg.methods["DOP853"]
    points = zip((p.parent for p in given.tree.points), given.point_coefficients, strict=True)
    tree = given.tree
    exchanged = cg.CommutatorFree(
        points, tree.stage_points, tree.embedded_result, embedded_result=tree.result,
        third=given.third_weights,
    )  # fmt: skip
    assert (exchanged.order, exchanged.embedded_order) == (5, 8)
    assert exchanged.table().exponent == given.table().exponent
    f = lambda t, y: np.array([np.sin(t), np.cos(3.0 * t), 0.5 * y[0, 1]])
    trials = [
        Step(f, cg.frames.SO3(), method).trial(0.2, np.eye(3), 0.7, 1e-6, 1e-6)
        for method in (given, exchanged)
    ]
    np.testing.assert_allclose(trials[1][0], trials[0][0], rtol=0, atol=1e-15)
    assert trials[1][1] == pytest.approx(trials[0][1], rel=1e-9)
    runs = [
        cg.solve_ivp(f, (0, 5), np.eye(3), frame=cg.frames.SO3(), method=method, rtol=1e-6)
        for method in (given, exchanged)
    ]
    assert abs(runs[1].nfev - runs[0].nfev) < 0.1 * runs[0].nfev
