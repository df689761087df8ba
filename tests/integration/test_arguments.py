"""Arguments of the integration functions: rejected and accepted values."""

import inspect
from collections import UserDict
from fractions import Fraction

import numpy as np
import pytest
from compiled_examples import PROBLEMS
from frame_examples import HEISENBERG
from refusals import refuses
from scipy.integrate import RK45

import cg
from cg.construction.methods.tableau import Tableau
from cg.frames import SO3, Euclidean

pytestmark = pytest.mark.sanitize

HUGE = 10**400
MIDPOINT = Tableau([["1/2"]], ["1"])
NO_SPANS = [
    (False, True), (0.0, True), np.array([False, True]), (np.False_, 1.0), {0.0, 1.0},
    frozenset([0.0, 1.0]), {0.0: 1.0, 1.0: 2.0}, UserDict({0.0: 1.0, 1.0: 2.0}), "01", b"01",
    (0.0, 1j), np.ma.masked_array([0.0, 1.0], mask=[0, 1]), [[0.0], [1.0]], 1.0, None,
    (0.0, 1.0, 2.0), ("a", "b"), ("0", "1"), (0, HUGE),
]  # fmt: skip


def never(*arguments):
    raise AssertionError("a function was called although an argument is bad")


def turn(t, y, *parameters):
    return [0.1, 0.2, 0.3]


def solve(f=never, t_span=(0.0, 1.0), y0=None, **options):
    options = {"frame": SO3()} | options
    return cg.solve_ivp(f, t_span, np.eye(3) if y0 is None else y0, **options)


ONE = {"f": never, "t_span": (0.0, 1.0), "y0": np.eye(3), "frame": SO3(), "t0": 0.0}
MANY = ONE | {"y0": np.stack([np.eye(3)] * 4)}
CALLS = [
    (cg.solve_ivp, ONE),
    (cg.integrate, ONE | {"method": "CG3", "h": 0.1}),
    (cg.solve_linear, ONE),
    (cg.solve_variational, ONE),
    (cg.Stepper, ONE | {"t_bound": 1.0}),
    (cg.solve_ensemble, MANY),
    (cg.solve_linear_ensemble, MANY),
    (cg.solve_variational_ensemble, MANY),
]
FORWARD = {"derivatives": "forward"}
FIXED = {"h": 0.1, "method": "CG3"}
LINEAR = {cg.solve_linear, cg.solve_linear_ensemble}
ADAPTIVE = {"rtol", "atol", "first_step", "max_steps"}


def check_rejected(calls, changes, error, message):
    """Check that all functions that have the arguments raise the error, without calling f."""
    count = 0
    for function, valid in calls:
        names = inspect.signature(function).parameters
        if function in LINEAR and changes.keys() & {"jac", "derivatives"}:
            continue  # refused for other reasons, as is the next
        if function is cg.integrate and "h" not in changes and changes.keys() & ADAPTIVE:
            continue
        if changes.keys() <= names.keys():
            count += 1
            arguments = {name: value for name, value in valid.items() if name in names}
            refuses(error, message, function, **arguments | changes)
    assert count


@pytest.mark.parametrize(("function", "valid"), CALLS)
@pytest.mark.parametrize(("name", "similar"), [("max_stp", "max_step"), ("jacc", "jac")])
def test_misspelt_argument(function, valid, name, similar):
    names = inspect.signature(function).parameters
    arguments = {name: value for name, value in valid.items() if name in names}
    message = rf"^{function.__name__}\(\) got .* '{name}'; similar names are {similar}"
    refuses(TypeError, message, function, **arguments, **{name: 1})


@pytest.mark.parametrize(("function", "valid"), CALLS)
def test_misspelt_or_missing_frame(function, valid):
    names = inspect.signature(function).parameters
    assert names["frame"].default is inspect.Parameter.empty
    arguments = {name: value for name, value in valid.items() if name in names}
    frame = arguments.pop("frame")
    with pytest.raises(TypeError, match=r"unexpected .* 'frames'; similar names are frame"):
        function(**arguments, frames=frame)
    refuses(TypeError, r"frame must be a Frame such as .*, got None", function, **arguments)


@pytest.mark.parametrize(("function", "name", "hint"), [
    (cg.Stepper, "t_eval", "; cg.solve_ivp takes it"),
    (cg.Stepper, "executor", "; cg.solve_ensemble takes it"),
    (cg.solve_linear, "common_steps", "; cg.solve_ensemble takes it"),
    (cg.solve_ensemble, "save_every", "; cg.integrate takes it"),
    (cg.integrate, "dt", "; the option is called h"),
    (cg.solve_ivp, "dense", "; the option is called dense_output"),
    (cg.solve_ivp, "zzz", "; the options are frame, method, h"),
])  # fmt: skip
def test_options_of_other_functions_and_other_names(function, name, hint):
    message = f"{function.__name__}.* unexpected keyword argument '{name}'{hint}"
    names = inspect.signature(function).parameters
    valid = {given: value for given, value in dict(CALLS)[function].items() if given in names}
    refuses(TypeError, message, function, **valid, **{name: 1})


def test_signatures_show_all_options():
    options = inspect.signature(cg.solve_ivp).parameters
    assert options["max_step"].default == np.inf
    for function, _ in CALLS:
        if function is not cg.Stepper:
            assert not options.keys() - inspect.signature(function).parameters.keys(), function
    assert inspect.signature(cg.solve_linear).parameters["linear"].default is True


@pytest.mark.parametrize(("changes", "error", "message"), [
    ({"f": 3}, TypeError, r"f must be callable as f\(t(, y)?\), got 3"),
    ({"method": "CG99"}, ValueError, "got 'CG99'.* CG3"),
    ({"f": never, "method": RK45}, TypeError, r"RK45'>; .*DP5\(4\) has its"),
    ({"f": never, "method": "RK45"}, ValueError, r"'RK45'; .*DP5\(4\) has its"),
    ({"f": never, "method": "DOP835"}, ValueError, "'DOP835'; similar names are DOP853"),
    ({"rtol": 1e-3, "method": "CG4a"}, ValueError, "method must be a pair unless h .*'CG4a'"),
    ({"method": MIDPOINT, "h": 0.1, "stage_solver": "hope"}, ValueError, "stage_solver must"),
    ({"method": "RadauIIA5", "stage_solver": "fixed-point"}, ValueError, "'newton' with .*Radau"),
    *(({"t_span": span}, ValueError, "t_span must be two numbers") for span in NO_SPANS),
    ({"t_span": (0.0, np.nan)}, ValueError, "t_span must be two numbers, the first one finite"),
    ({"t_span": (0.0, np.inf), "h": 0.1}, ValueError, "t_span must be finite with h"),
    ({"t_span": (-1.7e308, 1.7e308)}, ValueError, "t_span must have a finite length"),
    ({"t0": "0"}, TypeError, "t0 must be a real number"),
    ({"t0": np.inf}, ValueError, "t0 must be a finite number"),
    ({"t_bound": np.nan}, ValueError, "t_bound must be"),
    ({"rtol": -1e-3}, ValueError, "rtol must be finite and not negative, got -0.001"),
    ({"rtol": "low"}, TypeError, "rtol must be a real number"),
    ({"rtol": [1e-3, 1e-3]}, ValueError, r"rtol must be a number or have shape \(3,\)"),
    ({"atol": -1.0}, ValueError, "atol must be finite and not negative"),
    ({"atol": [1e-6, 1e-6]}, ValueError, r"atol must be a number or have shape \(3,\)"),
    ({"atol": "low"}, TypeError, "atol must be a real number"),
    *(
        ({"h": value}, ValueError, "h must be finite and positive, got")
        for value in (0.0, -0.1, np.nan, np.inf, np.float32("inf"), HUGE)
    ),
    ({"h": Fraction(1, HUGE)}, ValueError, "h must be finite and positive, got"),
    ({"h": "0.1"}, TypeError, "h must be a real number, got '0.1'"),
    ({"t_span": (0, 1), "h": 1e-300}, ValueError, "h must lead to distinct times"),
    ({"h": 1e-9, "t_eval": [0.5], "dense_output": True}, ValueError, ".* need .* got 1e-09"),
    ({**FIXED, "rtol": 1e-3}, ValueError, "rtol must not be given together with h"),
    ({**FIXED, "atol": 1e-3}, ValueError, "atol must not be given together with h"),
    ({**FIXED, "first_step": 0.1}, ValueError, "first_step must not be given together"),
    ({**FIXED, "max_step": 0.05}, ValueError, "h must not be larger than max_step = 0.05"),
    ({**FIXED, "max_steps": 3}, ValueError, "max_steps must not be given together with h"),
    ({"max_step": 0.0}, ValueError, "max_step must be positive, got 0.0"),
    ({"max_step": "small"}, TypeError, "max_step must be a real number"),
    ({"max_steps": 0}, ValueError, "max_steps must be at least 1, got 0"),
    ({"max_steps": 1e3}, TypeError, "max_steps must be an integer, got 1000.0"),
    ({"save_every": 0}, ValueError, "save_every must be at least 1, got 0"),
    ({"first_step": 0.0}, ValueError, "first_step must be finite and positive"),
    ({"first_step": 2.0, "t_span": (0, 1)}, ValueError, "first_step must not exceed the leng"),
    ({"t_eval": [0.1, 2.0]}, ValueError, "t_eval must lie within t_span, 0 to 1"),
    ({"t_eval": [np.nan]}, ValueError, "t_eval must lie within t_span"),
    ({"t_eval": [0.5, 0.4]}, ValueError, "t_eval must be strictly sorted"),
    ({"t_eval": [1.0, np.nextafter(1.0, 2.0)]}, ValueError, "t_eval must be strictly sorted"),
    ({"t_span": (1.0, 0.0), "t_eval": [0.4, 0.5]}, ValueError, "in the direction of integr"),
    ({"t_eval": [[0.5]]}, ValueError, "t_eval must have one axis"),
    ({"dense_output": "no"}, TypeError, "dense_output must be True or False, got 'no'"),
    *(
        ({"args": value}, TypeError, "args must be a tuple .*, got")
        for value in ("ab", b"ab", {1, 2}, {"a": 1}, 1.0, np.zeros(3))
    ),
    ({"events": 3}, TypeError, "events must be a function or a sequence"),
    ({"events": [3]}, TypeError, r"events\[0\] must be callable"),
    ({"breakpoints": [[0.5]]}, ValueError, "breakpoints must have one axis"),
    ({"breakpoints": [0.7, 0.3]}, ValueError, "breakpoints must be strictly sorted in"),
    ({"breakpoints": [np.nan]}, ValueError, "breakpoints must lie between the ends"),
    ({"progress": 3}, TypeError, "progress must be callable, got 3"),
    ({**FORWARD, "jac": 3}, TypeError, r"jac must be callable as jac\(t, y\), got 3"),
    ({**FORWARD, "df_dp": print}, ValueError, "parameters must be given with df_dp = .* got None"),
    ({**FORWARD, "P0": np.full((3, 3), np.nan)}, ValueError, "P0 must be finite, got nan"),
    ({**FORWARD, "P0": np.triu(np.ones((3, 3)))}, ValueError, "P0 must be symmetric"),
    ({**FORWARD, "P0": -np.eye(3)}, ValueError, "P0 must be positive semidef.* eigenvalue -1"),
    ({"control_derivatives": 1}, TypeError, "control_derivatives must be True or False"),
    ({"linear": True, "jac": never}, ValueError, "jac must be None with linear=True"),
    ({"linear": True, **FORWARD}, ValueError, "derivatives must be None.* with linear=True"),
    ({"derivatives": None, "P0": np.eye(3)}, ValueError, "(must be .* P0, got|must not be) None"),
])  # fmt: skip
def test_bad_arguments_are_rejected_before_any_work(changes, error, message):
    check_rejected(CALLS, changes, error, message)


@pytest.mark.parametrize(("changes", "error", "message"), [
    ({"y0": np.eye(2)}, ValueError, r"y0 must have shape \(3, 3\), got \(2, 2\)"),
    ({"y0": np.full((3, 3), np.nan)}, ValueError, "y0 must be finite"),
    ({"y0": np.diag([1, 1, 1.001])}, ValueError, "y0 must be a point of SO3.* is 0.001, more"),
    ({"y0": np.diag([1.0, 1.0, -1.0])}, ValueError, "is 2.*; y0 must .* got -1, of a left"),
    ({"y0": np.diag([-0.9, 1.0, 1.1])}, ValueError, "determinant .* got -0.99, of a left"),
    ({"y0": "north"}, ValueError, "y0 must be an array of real numbers"),
    ({"y0": [[HUGE, 0, 0], *np.eye(3)[1:]]}, ValueError, "y0 must be"),
    ({"y0": np.ma.masked_equal(np.eye(3), 1)}, ValueError, "y0 must be .* got masked_array"),
    ({"h": 1e-9, "dense_output": False}, ValueError, "larger for t_span: 1000000000 steps"),
    ({"parameters": [[1.0]]}, ValueError, r"parameters must have shape \(k,\)"),
    ({**FORWARD, "df_dp": 3, "parameters": [1.0]}, TypeError, "df_dp must be callable .* got 3"),
    ({**FORWARD, "P0": np.eye(2)}, ValueError, r"P0 must have shape \(3, 3\), got \(2, 2\)"),
    ({"atol": np.ones(12)}, ValueError, r"atol must be .* have shape \(3,\)"),
    ({**FORWARD, "frame": HEISENBERG, "y0": np.zeros(3)}, ValueError,
     "frame must know the bracket"),
    *(({"frame": cg.frames.Product(cg.frames.SO3(), cg.frames.Euclidean(2)),
        "y0": kind([np.eye(3), [0.0] * 2])}, ValueError, "y0 .*; frame.join makes a point")
      for kind in (list, tuple)),
])  # fmt: skip
def test_bad_arguments_of_one_point_are_rejected(changes, error, message):
    check_rejected(CALLS[:5], changes, error, message)


def test_a_stepper_of_one_point_takes_no_vectorized_function():
    check_rejected(CALLS[4:5], {"vectorized": True}, ValueError, "must be False for a single point")


@pytest.mark.parametrize(("changes", "error", "message"), [
    ({"y0": np.ones((2, 2, 3, 3))}, ValueError, r"y0 must have one axis before shape \(3, 3\)"),
    ({"y0": np.ones((0, 3, 3))}, ValueError, "y0 must hold at least one point"),
    ({"y0": [np.eye(3), 1.1 * np.eye(3)]}, ValueError, r"y0\[1\] must be a point of .* 0.1"),
    ({"y0": [np.eye(3), -np.eye(3)]}, ValueError, r"is 2.*; y0\[1\] must have a positive det"),
    ({"y0": [np.eye(3), np.inf * np.ones((3, 3))]}, ValueError, r"y0\[1\] must be finite"),
    ({"parameters": np.ones((3, 2))}, ValueError, r"parameters must have shape \(4, k\), got"),
    ({"y0": np.eye(3), "parameters": [1.0, 2.0]}, ValueError, r"shape \(members, k\), got"),
    ({"common_steps": "yes"}, TypeError, "common_steps must be"),
    ({"common_steps": True, "workers": 2}, ValueError, "executor and workers must be None"),
    ({"common_steps": True, "events": cg.Event(never, jump=never)}, ValueError, "no jumps"),
    ({"executor": "fast"}, ValueError, "executor must be 'processes' or an executor"),
    ({"workers": 0}, ValueError, "workers must be at least 1"),
    ({**FORWARD, "out": np.zeros(4)}, ValueError, "out must be None with derivatives"),
    ({"derivatives": "adjoint"}, ValueError, "derivatives must be None.* for an ensemble"),
    ({**FORWARD, "P0": np.array([1e9, 1, -1, 1])[:, None, None] * np.eye(3)}, ValueError,
     "P0 must be positive semidef.* eigenvalue -1"),
    ({**FORWARD, "P0": np.zeros((3, 2, 2))}, ValueError, r"P0 must have .*3\) or \(4, 3, 3\)"),
])  # fmt: skip
def test_bad_arguments_of_ensembles_are_rejected(changes, error, message):
    check_rejected(CALLS[5:], changes, error, message)


@pytest.mark.parametrize(("changes", "message"), [
    ({"y0": [1.0, 2.0]}, "y0 must have shape"),
    ({"y0": [np.nan]}, "y0 must be finite"),
    ({"h": -0.1}, "h must be finite and positive"),
    ({"h": 1e-15}, "h must be larger for t_span: 1000000000000000 steps need"),
    ({"args": (1,)}, "args must be None for a compiled f"),
    ({"vectorized": True, "y0": [[1.0]]}, "vectorized must be False for a compiled f"),
])  # fmt: skip
def test_bad_arguments_with_a_compiled_function_are_rejected(changes, message, compiled_function):
    valid = {"y0": [1.0], "frame": Euclidean(1), "method": "CG3", "h": 0.5, "t_span": (0, 1)}
    call = cg.solve_ensemble if "vectorized" in changes else cg.solve_ivp
    refuses(ValueError, message, call, compiled_function("growth"), **valid | changes)


def test_parameters_are_for_compiled_functions_without_data(affine_rhs):
    f, _data = affine_rhs(PROBLEMS["SO3 body"])
    with pytest.raises(ValueError, match="parameters must be None for a compiled f that has user"):
        cg.solve_ensemble(f, (0, 1), np.eye(3), frame=SO3(), parameters=[[1.0]])


def test_points_of_ensembles_are_rejected_by_functions_for_one():
    for call, options in ((cg.solve_ivp, {}), (cg.integrate, FIXED)):
        with pytest.raises(ValueError, match=r"y0 must .*cg\.solve_ensemble integrates many"):
            call(never, (0, 1), np.stack([np.eye(3)] * 2), frame=SO3(), **options)


@pytest.mark.parametrize(
    "t_span", [[0, 1], np.array([0, 1]), (Fraction(0), Fraction(1)), np.float32([0, 1]), range(2)]
)
def test_spans_of_all_kinds_of_numbers(t_span):
    assert solve(turn, t_span, h=0.5).t.tolist() == [0.0, 0.5, 1.0]


def test_a_first_step_may_be_as_long_as_the_span():
    for span in ((0.0, 1.0), (-1.0, 1.0), (2.0, -1.0)):
        length = abs(span[1] - span[0])
        solution = solve(lambda t, y: [1e-3, 0.0, 0.0], span, first_step=length)
        assert solution.steps == 1
        with pytest.raises(ValueError, match="first_step must not exceed the length of t_span"):
            solve(t_span=span, first_step=np.nextafter(length, 9.0))


@pytest.mark.parametrize(("function", "name", "value"), [
    (cg.solve_linear, "linear", False), (cg.solve_linear_ensemble, "linear", False),
    (cg.solve_variational, "derivatives", None),
    (cg.solve_variational_ensemble, "derivatives", None),
])  # fmt: skip
def test_what_a_function_is_named_after_cannot_be_left_out(function, name, value):
    frame = cg.frames.Euclidean(1)
    message = f"{name} must not be {value} in {function.__name__}"
    refuses(ValueError, message, function, never, (0, 1), [1.0], frame=frame, **{name: value})


def test_integrate_refuses_to_store_steps_and_times():
    options = {"frame": cg.frames.Euclidean(1), "h": 0.1, "method": "CF4"}
    message = "save_every must be 1 with t_eval, got 3"
    refuses(ValueError, message, cg.integrate, never, (0, 1), [1.0], **options, save_every=3,
            t_eval=[0.5])  # fmt: skip


def test_residuals_refuse_weights_with_a_method():
    refuses(TypeError, "b must not .* got 'x'", cg.conditions.residuals, cg.methods["CF4"], "x", 2)


def test_a_single_stepper_has_no_output_before_its_first_step():
    stepper = cg.Stepper(lambda t, y: [1.0], 0.0, [0.0], 1.0, frame=cg.frames.Euclidean(1))
    refuses(RuntimeError, "must come after a step$", stepper.dense_output)
