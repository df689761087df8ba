"""Steps of the methods of the catalogue, for diffrax; divergences of fields, for densities."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from cg.frames import Euclidean, Frame, Power, Product
from cg.frames.facts import check_brackets
from cg.frames.manifold import MEMBERSHIP_TOLERANCE
from cg.frames.user import UserFrame
from cg.jax.control import LastStep, error_estimate
from cg.jax.frames import rules_of, turning
from cg.jax.rules import JaxArray, Rules, read_point, real_dtype
from cg.jax.stages import Start, StepInterpolation, interpolant, interpolant_of_noise, take_stages
from cg.jax.term import FrameTerm, LinearTerm, check_noise, increments, rules_in, unwrapped
from cg.support.checks import check_flag, check_real
from cg.support.shared_numbers import PARTS_OF_TURN
from cg.tables import HasTable, Kind, MethodTable, unique_table

_MAX_ANGLE = 2.0 * math.pi / PARTS_OF_TURN
_CALLERS = 13  # callers to search; equinox has some between diffrax and a solver


class SolverState(eqx.Module):
    """The state that a step hands to the next one."""

    at_start: JaxArray  # coefficients at the start of the step
    last_step: LastStep | None  # the step before, of Magnus methods
    has_events: bool = eqx.field(static=True)
    between: bool = eqx.field(static=True)  # whether points within steps are asked for


class Solver(diffrax.AbstractAdaptiveSolver, diffrax.AbstractStratonovichSolver):
    r"""An explicit method of the catalogue, or of the user, as a solver of `diffrax.diffeqsolve`.

    Its term is a `FrameTerm`. The error estimate of a pair is a tangent at the end of the step:
    ``diffrax.PIDController`` compares it with the entries of points, and `controller` with
    coordinates, as `cg.solve_ivp` does.

    Parameters
    ----------
    method
        The name of a method, or a method.
    unroll
        Whether `XLA` compiles the stages one after the other instead of as a loop: a single
        solution takes a little less time, compiling and batches by ``jax.vmap`` take more.
    max_angle
        Largest rotation in a step that is accepted, in radians, where steps are chosen and there is
        an event; None for no limit. diffrax compares signs of events at the ends of steps only, and
        steps along constant coefficients may be longer than a turn. The default is π/6.

    Raises
    ------
    RuntimeError
        When it is used: if ``y0`` is farther from the manifold than 1e-8, or 1e-5 in single
        precision. ``EQX_ON_ERROR=off`` in the environment turns this check of `equinox` off.

    Notes
    -----
    The stored coefficients of the method are rounded to the precision of the points. Output between
    steps, by ``SaveAt(ts=...)`` or ``SaveAt(dense=True)``, and events use the interpolant of
    `cg.solve_ivp`, as accurate as the steps, which evaluates ``f`` a few more times in every step.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.jax.Solver("CF7(6)")
    Solver("CF7(6)")
    """

    table: MethodTable = eqx.field(static=True)
    unroll: bool = eqx.field(static=True)
    max_angle: float | None = eqx.field(static=True)

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., Any]] = StepInterpolation

    def __init__(
        self, method: str | HasTable, *, unroll: bool = False, max_angle: float | None = _MAX_ANGLE
    ) -> None:
        if isinstance(method, str) and method == "auto":
            raise ValueError(
                'method must be named in JAX, which has no "auto"; of the pairs "RKMK8(5,3)" takes '
                'the least time in the benchmarks, and "CF5(4)" needs no brackets; "CF4" is for '
                "fixed steps"
            )
        table = unique_table(method)
        if not table.explicit:
            raise ValueError(f"method must be explicit in JAX, got {table!r}")
        if table.kind is Kind.SPLITTING:
            raise ValueError(f"method must not be a splitting method in JAX, got {table!r}")
        unroll = check_flag("unroll", unroll)
        if max_angle is not None:
            max_angle = check_real("max_angle", max_angle, positive=True, infinite=True)
        self.table = table
        self.unroll = unroll
        self.max_angle = max_angle

    def __repr__(self) -> str:
        label = f'"{self.table.name}"' if self.table.name else repr(self.table)
        suffix = ", unroll=True" if self.unroll else ""
        suffix += "" if self.max_angle == _MAX_ANGLE else f", max_angle={self.max_angle}"
        return f"Solver({label}{suffix})"

    def order(self, terms: Any) -> int:
        """Return the order of the method."""
        return max(self.table.order, self.table.embedded_order or 0)

    def error_order(self, terms: Any) -> float | None:
        """Return the power of the step that the estimate is proportional to; None without one."""
        return 1.0 / self.table.exponent if self.table.exponent else None

    def strong_order(self, terms: Any) -> float:
        """Return the strong order for noise whose fields don't commute."""
        return 0.5

    def func(self, terms: Any, t0: JaxArray, y0: JaxArray, args: Any) -> JaxArray:
        """Return the coefficients at a point."""
        _refuse_implicit_adjoint(rules_in(terms).frame)
        drift = terms.terms[0] if isinstance(terms, diffrax.MultiTerm) else terms
        return drift.vf(t0, y0, args)

    def init(self, terms: Any, t0: Any, t1: Any, y0: JaxArray, args: Any) -> Any:
        """Return the state, after checking the term and the point."""
        rules = rules_in(terms)
        frame = rules.frame
        if self.table.on_algebra or self.table.has_brackets:
            check_brackets(frame, self.table)
        if self.table.kind is Kind.LINEAR and not isinstance(unwrapped(terms), LinearTerm):
            raise ValueError(
                f"method must be for nonlinear equations, got {self.table!r}; those of time alone "
                "are a cg.jax.LinearTerm"
            )
        if isinstance(terms, diffrax.MultiTerm):
            check_noise(terms, self.table)
        at_start = self.func(terms, t0, y0, args)
        tolerance = max(MEMBERSHIP_TOLERANCE, 100.0 * float(jnp.finfo(y0.dtype).eps))
        at_start = eqx.error_if(
            at_start,
            ~(rules.relative_error(y0) <= tolerance),
            f"y0 must be within {tolerance:.1g} of the manifold of {frame!r}; frame.project(y0) "
            "returns the nearest point",
        )
        real = at_start.dtype
        none = jnp.zeros((), real), jnp.zeros((len(self.table.c), frame.dim), real)
        last_step = LastStep(*none) if self.table.kind is Kind.LINEAR else None
        return SolverState(at_start, last_step, *_events_and_output())

    @eqx.filter_jit  # diffrax calls a step three times, twice for the types of what it returns
    def step(
        self, terms: Any, t0: JaxArray, t1: JaxArray, y0: JaxArray, args: Any, solver_state: Any,
        made_jump: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Return the point after a step, its error, the interpolant, the state and the result."""
        rules, table = rules_in(terms), self.table
        if isinstance(terms, diffrax.MultiTerm):
            return self._noisy_step(rules, increments(terms, t0, t1, args), y0, solver_state)
        at_start, last_step = solver_state.at_start, solver_state.last_step
        h = jnp.asarray(terms.contr(t0, t1), at_start.dtype)

        def f(c: Any, y: JaxArray) -> JaxArray:
            return terms.vf(t0 + c * (t1 - t0), y, args)

        if made_jump is not False:
            at_start = jax.lax.cond(made_jump, lambda: f(0.0, y0), lambda: at_start)
            if last_step is not None:
                last_step = LastStep(jnp.where(made_jump, 0.0, last_step.h), last_step.values)
        start = Start(rules, f, h, y0, at_start)
        between = solver_state.between
        stages = take_stages(table, start, unroll=self.unroll, with_end=True, between=between)
        at_end = f(1.0, stages.result) if stages.at_end is None else stages.at_end
        within = interpolant(table, start, stages, at_end) if between else None
        error = error_estimate(table, start, stages, last_step)
        if error is not None and solver_state.has_events and self.max_angle is not None:
            too_far = turning(rules.frame, h * stages.values[0]) > self.max_angle
            error = jnp.where(
                too_far | (turning(rules.frame, h * at_end) > self.max_angle), jnp.inf, error
            )
        last_step = None if last_step is None else LastStep(h, stages.values)
        state = SolverState(at_end, last_step, solver_state.has_events, between)
        return stages.result, error, {"within": within}, state, _result(stages.result)

    def _noisy_step(
        self, rules: Rules, f: Callable[[Any, JaxArray], JaxArray], y0: JaxArray, state: Any
    ) -> tuple[Any, ...]:
        """Take a step of size one along increments; there is no error estimate."""
        at_start = f(0.0, y0)
        start = Start(rules, f, jnp.ones((), at_start.dtype), y0, at_start)
        stages = take_stages(self.table, start, unroll=self.unroll, with_end=False, between=False)
        within = interpolant_of_noise(self.table, start, stages) if state.between else None
        return stages.result, None, {"within": within}, state, _result(stages.result)


def _refuse_implicit_adjoint(frame: Frame) -> None:
    """Raise NotImplementedError if diffrax's ImplicitAdjoint asks for f on a manifold.

    It solves f(y) = 0 for the entries of y. A solver isn't told the adjoint, but that adjoint calls
    ``f`` from a function of its own, which is among the callers.
    """
    if not isinstance(frame, Euclidean) and _caller("diffrax._adjoint", "_vf") is not None:
        raise NotImplementedError(
            "adjoint must not be ImplicitAdjoint on a manifold, where f(y) = 0 does not "
            "determine the entries of y; RecursiveCheckpointAdjoint gives the gradient"
        )


def _events_and_output() -> tuple[bool, bool]:
    """Return whether there is an event, and output between steps, which a solver isn't told.

    Outside of `diffeqsolve` any point may be asked for.
    """
    solve = _caller("diffrax._integrate", "diffeqsolve")
    if solve is None:
        return False, True
    has_events, saveat = solve["event"] is not None, solve["saveat"]
    outputs = jax.tree.leaves(saveat.subs, is_leaf=lambda x: isinstance(x, diffrax.SubSaveAt))
    between = saveat.dense or any(output.ts is not None for output in outputs)
    return has_events, has_events or between


def _caller(module: str, name: str) -> dict[str, Any] | None:
    """Return the variables of a function that is among the callers, or None."""
    # Names of diffrax 0.7.0 and 0.7.2; with others test_implicit_adjoints fails, as does
    # test_steps_longer_than_a_turn_do_not_pass_over_events, and all steps make interpolants.
    caller = inspect.currentframe()
    for _ in range(_CALLERS):
        if caller is None:
            return None
        if (caller.f_globals.get("__name__"), caller.f_code.co_name) == (module, name):
            return caller.f_locals
        caller = caller.f_back
    return None


def _result(y: JaxArray) -> Any:
    finite = jnp.isfinite(y).all()
    return diffrax.RESULTS.where(finite, diffrax.RESULTS.successful, diffrax.RESULTS.nonfinite)


def divergence(
    f: Callable[[Any, Any, Any], Any], frame: Frame, *, key: Any = None
) -> Callable[[Any, Any, Any], JaxArray]:
    r"""Return a function ``(t, y, args)``: the divergence with respect to the invariant volume.

    The fields of a frame preserve the invariant volume of its manifold: Haar measure on groups,
    area on spheres. So the divergence of :math:`\sum_i f_i E_i` is :math:`\sum_i E_i f_i`, and
    along solutions the logarithm of a density decreases by its integral.

    Parameters
    ----------
    f
        ``f(t, y, args)`` as for `FrameTerm`.
    frame
        A frame that `cg.jax` supports, but none with fields of the user.
    key
        A key of ``jax.random``. With it the result is Hutchinson's estimate, one derivative in a
        random direction of entries ±1, instead of the sum of ``frame.dim`` derivatives. Its mean
        is the divergence. Use one key for a whole integration.

    Examples
    --------
    The gradient of the height on a sphere, at the north pole:

    >>> import crouch_grossman as cg, jax.numpy as jnp
    >>> north, sphere = jnp.array([0.0, 0.0, 1.0]), cg.frames.Sphere(2)
    >>> rate = cg.jax.divergence(lambda t, y, args: jnp.cross(y, north), sphere)
    >>> float(rate(0.0, north, None))
    -2.0
    """
    term, rules = FrameTerm(f, frame), rules_of(frame)
    if user_frame := _user_frame_in(frame):
        raise ValueError(
            f"frame must have a known invariant volume, got fields of the user: {user_frame}"
        )

    def evaluate(t: Any, y: Any, args: Any) -> JaxArray:
        y = read_point(frame, y)
        zero = jnp.zeros(frame.dim, real_dtype(y))

        def along(v: JaxArray) -> JaxArray:
            return term.vf(t, rules.flow(v, y), args)

        if key is None:
            return jnp.trace(jax.jacfwd(along)(zero))
        direction = jax.random.rademacher(key, (frame.dim,), zero.dtype)
        return direction @ jax.jvp(along, (zero,), (direction,))[1]

    return evaluate


def _user_frame_in(frame: Frame) -> Frame | None:
    """Return the first factor whose fields the user gives, None if there is none."""
    if isinstance(frame, UserFrame):
        return frame
    if isinstance(frame, Power):
        return _user_frame_in(frame.factor)
    factors = frame.factors if isinstance(frame, Product) else ()
    return next(filter(None, map(_user_frame_in, factors)), None)
