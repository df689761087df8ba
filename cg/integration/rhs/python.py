"""Functions of users in Python: right-hand sides, ``jac``, ``df_dp``; checks of their values."""

from __future__ import annotations

import math
from array import array as typed_array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from cg import _core_r64 as core
from cg.frames.base import Frame
from cg.frames.phase_space import PhaseSpace
from cg.integration.rhs.compiled import CompiledRhs, call_rhs, compiled_rhs
from cg.integration.rhs.form import RhsForm
from cg.integration.rhs.function import TimeFunction
from cg.integration.rhs.inputs import ExtraArguments, Inputs, WithInput, data_at
from cg.support.arrays import Array, Points, complex_array, conversion_hint, read_only, real_array
from cg.support.checks import short
from cg.support.frozen import filled
from cg.tables import Kind, MethodTable

# addresses of functions in C that call one of Python, and functions of a variational equation
CALL_PYTHON, CALL_VARIATIONAL = core.function_addresses()

# called with a value, t and y: returns the value as an array, or raises
Check = Callable[[Any, Any, Any], Points]


def time_text(t: Any) -> str:
    """Return the time of a call, or the first of many times, for a message."""
    return f"t = {np.atleast_1d(t)[0]:.17g}"


def read_value(
    value: Any, name: str, shape: tuple[int, ...], t: Any, rows: str = "",
    hint: Callable[..., str] | None = None, number: bool = False, dtype: Any = np.float64,
) -> Points:  # fmt: skip
    """Return the result of a function at ``t`` as a new array; ValueError if it has another shape.

    A vectorized function returns ``rows``, each of a member or of a time. `hint` returns the end of
    the message about another shape.
    """
    per_row = f", a row for each {rows}, since vectorized=True" if rows else ""
    try:
        array: Points = (real_array if dtype == np.float64 else complex_array)(value, name)
    except ValueError as error:
        kind = "real" if dtype == np.float64 else "complex"
        expected = f"a {kind} number" if math.prod(shape) == 1 else f"{shape[0]} {kind} numbers"
        if len(shape) > 1:
            expected = f"an array of {kind} numbers of shape {shape}"
        raise ValueError(
            f"{name} must return {expected}{per_row}, got {short(value)} at {time_text(t)}"
            f"{conversion_hint(value, error)}"
        ) from error
    if number and array.size == 1 == math.prod(shape):
        array = array.reshape(shape)
    if array.shape != shape:
        expected = f"an array of shape {shape}{per_row}" if shape else "one number"
        raise ValueError(
            f"{name} must return {expected}, got shape {array.shape} at {time_text(t)}"
            f"{hint(array.shape) if hint else ''}"
        )
    return array


def read_finite(
    value: Any, name: str, shape: tuple[int, ...], t: Any, number: bool = False
) -> Array:
    """Return the result of a function as a new array; ValueError unless it is finite as well.

    A single number may have any shape if ``number``.
    """
    array = read_value(value, name, shape, t, number=number)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must return finite numbers, got {short(value)} at {time_text(t)}")
    return array


class RhsCheck:
    """The check of results of ``f``."""

    def __init__(self, f: Callable[..., Any], form: RhsForm, vectorized: bool = False) -> None:
        self.form, self.vectorized = form, vectorized
        function = f.function if isinstance(f, WithInput) else f
        self.takes_no_point = isinstance(function, TimeFunction)
        self.rows = ("time" if self.takes_no_point else "member") if vectorized else ""

    def hint(self, shape: tuple[int, ...]) -> str:
        """Return the advice on a value of another shape, an empty text without any."""
        frame = self.form.frame
        if self.takes_no_point:
            vee = f"; vee of {frame!r} makes those of a matrix of its Lie algebra"
            return vee if hasattr(frame, "vee") else ""
        # forces on phase spaces are no coefficients of all fields
        derivative = shape[self.vectorized :] == frame.point_shape and frame.rhs_dim == frame.dim
        return "; rhs='derivative' takes derivatives of y" if derivative else ""

    def __call__(self, value: Any, t: Any, y: Points | None = None) -> Points:
        """Return the result of ``f(t, y)`` as an array of the form's shape, or ``n`` of them.

        ValueError is raised if it has another shape. Numbers that aren't finite pass: compiled code
        rejects the step in which they are.
        """
        shape = (len(t), *self.form.shape) if self.vectorized else self.form.shape
        return read_value(value, "f", shape, t, self.rows, self.hint, dtype=self.form.dtype)


class CallContext(NamedTuple):
    """A call of a function, in the order in which ``fortran/interface/python_rhs.c`` reads it."""

    function: Callable[..., Any]
    args: tuple[Any, ...]  # its further arguments
    like_point: Points  # an array of the shape and the type of its points
    like_result: Points  # an array of the shape and the type of its results
    check: Check  # called with other than plain results
    spare: list[Any]  # arrays of the call before: the point, and numbers that change
    takes_no_point: bool
    with_input: bool  # whether it gets the value of its first argument, a function of time
    changing: bool  # whether numbers of the last argument change, so that it gets copies

    def with_arguments(self, args: tuple[Any, ...]) -> CallContext:
        """Return the context of the same function with other arguments."""
        args = _with_reader(args) if self.with_input else args
        entries = (
            self.function, args, self.like_point, self.like_result, self.check, [None, None],
            self.takes_no_point, self.with_input, self.changing,
        )  # fmt: skip
        return tuple.__new__(CallContext, entries)  # in less time than by _replace


def _with_reader(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return arguments with a function of time in place of the first one, a `Reader`."""
    return (args[0].function(), *args[1:])


def call_context(
    function: Callable[..., Any], args: tuple[Any, ...], templates: tuple[Points, Points],
    check: Check, changing: bool = False,
) -> CallContext:  # fmt: skip
    """Return the context of a function without its wrappers; for templates see `templates_of`."""
    with_input = takes_no_point = False
    if isinstance(function, WithInput):
        function, args, with_input = function.function, _with_reader(args), True
    if isinstance(function, TimeFunction):
        function, takes_no_point = function.function, True
    flags = takes_no_point, with_input, changing
    return CallContext(function, args, *templates, check, [None, None], *flags)


class Contexts:
    """The contexts of a function: one for each of a ``count`` of members, or one for all."""

    def __init__(
        self, function: Callable[..., Any], extra: ExtraArguments, count: int | None,
        templates: tuple[Points, Points], check: Check,
    ) -> None:  # fmt: skip
        first = call_context(function, extra.arguments(0), templates, check)
        self._connect(first, extra, count)

    def _connect(self, first: CallContext, extra: ExtraArguments, count: int | None) -> None:
        """Make the contexts of members, which are like the first one but for the arguments."""
        self.contexts = [first]
        if count is not None:
            others = map(extra.arguments, range(1, count))
            self.contexts += [first.with_arguments(arguments) for arguments in others]
        self._pointers = typed_array("Q", map(id, self.contexts))
        self.data_address = self._pointers.buffer_info()[0]
        self._stride = 0 if count is None else 8

    def addresses(self) -> tuple[int, int, int]:
        """Return the addresses of the function and of the first member's data, and their stride."""
        return CALL_PYTHON, self.data_address, self._stride


class PythonRhs(Contexts):
    """A right-hand side ``f(t, y, *args)``, or ``f(t, y, *args, parameters)``, in Python.

    Compiled code calls it through a function in C, whose data are its contexts.

    A ``vectorized`` function takes times ``(n,)``, points ``(n, *point_shape)`` and rows of
    parameters of several members, and returns shape ``(n, dim)``; one of time alone may get several
    times for one point.
    """

    writes_results = False

    def failed_name(self, member: int) -> str:
        """Return the name of the function that failed, of a member."""
        return "f"

    def __init__(
        self, f: Callable[..., Any], form: RhsForm, extra: ExtraArguments, vectorized: bool = False
    ) -> None:
        self.f, self.form, self.extra, self.vectorized = f, form, extra, vectorized
        self.check = RhsCheck(f, form, vectorized)
        members = None if vectorized else extra.members
        super().__init__(f, extra, members, form.templates, self.check)

    def __reduce__(self) -> tuple[Any, ...]:
        return PythonRhs, (self.f, self.form, self.extra, self.vectorized)

    def with_data(self, extra: ExtraArguments) -> PythonRhs:
        """Return the right-hand side with other further arguments, or of other members."""
        rhs = filled(PythonRhs, vars(self) | {"extra": extra})
        first = self.contexts[0].with_arguments(extra.arguments(0))
        rhs._connect(first, extra, None if self.vectorized else extra.members)
        return rhs

    def on_form(self, form: RhsForm) -> PythonRhs:
        """Return the function on another frame of the same points."""
        return PythonRhs(self.f, form, self.extra, self.vectorized)

    def note(self, t: float, member: int = 0) -> str:
        """Return a note to an exception at ``t`` in a member, which says how ``f`` is called."""
        names = ["t"] if self.check.takes_no_point else ["t", "y"]
        names += ["u"] * (self.extra.inputs is not None)
        names += [f"args[{k}]" for k in range(len(self.extra.args))]
        names += ["parameters"] * (self.extra.parameters is not None)
        where, shape = f"at t = {t:.17g}", str(self.form.frame.point_shape)
        if self.vectorized:
            shape = f"{('k', *self.form.frame.point_shape)}, and t of shape (k,)".replace("'", "")
        elif self.extra.first_member is not None:
            where += f" in member {self.extra.first_member + member}"
        with_shape = f" with y of shape {shape}" * (not self.check.takes_no_point)
        return f"{where}; f is given ({', '.join(names)}){with_shape}"

    def at_member(self, member: int, t: float, y: Points) -> Array:
        """Return the coefficients of a member as a new array, after checking them."""
        return self.form.complete(self.result(member, t, y), y)

    def result(self, member: int, t: float, y: Points) -> Array:
        """Return the result of ``f`` for a member as a new array, after checking it."""
        if self.vectorized:
            return np.asarray(self.results(np.array([t]), np.array([member]), y[None])[0])
        return self.check(self.f(t, read_only(y), *self.extra.arguments(member)), t)

    def results(self, t: Array, members: Any, y: Points) -> Array:
        """Return the results of ``f`` for several members, after checking them.

        The shape is ``(n, *form.shape)``.
        """
        t.setflags(write=False)
        y.setflags(write=False)
        try:
            value = self.f(t, y, *self.extra.arguments(members))
        except Exception as error:
            error.add_note(self.note(float(t[0])))
            raise
        return self.check(value, t)

    def at_times(self, times: Array, y: Points) -> Array:
        """Return the coefficients of a single member at times and points, of a linear equation."""
        if self.vectorized:
            return self.results(times.copy(), np.zeros(len(times), dtype=np.intp), y[:1].copy())
        return call_rhs(self, *self.addresses()[:2], self.form, times, y)


Rhs = CompiledRhs | PythonRhs


@dataclass(frozen=True, eq=False)
class Derivative:
    """A function of the user, in Python or compiled, with the arguments of ``f``."""

    name: str
    function: Any  # a `CompiledRhs` if it is compiled
    frame: Frame
    shape: tuple[int, ...]  # shape of its value at one point
    dtype: ClassVar[Any] = np.float64  # type of its value
    vectorized: bool = False  # whether it takes several points in one call

    def __call__(self, t: Any, y: Points, arguments: tuple[Any, ...], data: int = 0) -> Array:
        """Return the derivatives; a compiled function without its own data receives ``data``."""
        if isinstance(self.function, CompiledRhs):
            data = self.function.user_address or data
            return self.check(self.function.values(self, data, t, y[None])[0], t)
        return self.check(self.function(t, read_only(y), *arguments), t)

    def check(self, value: Any, t: Any, _: Any = None) -> Array:
        """Return the value of the function as a C-ordered array, after checking it."""
        value = value.toarray() if hasattr(value, "tocsc") else value
        expected = (len(t), *self.shape) if self.vectorized else self.shape
        return read_finite(value, self.name, expected, t, number=True)


def is_matrix(function: Any) -> bool:
    """Return whether a matrix is given in place of a function, sparse or not."""
    return isinstance(function, np.ndarray | list | tuple) or hasattr(function, "tocsc")


def _read_matrix(value: Any, name: str, shape: tuple[int, ...], vectorized: bool) -> Any:
    sparse = hasattr(value, "tocsc")
    matrix: Any = value if sparse else real_array(value, name)
    if matrix.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {matrix.shape}")
    return matrix.toarray() if sparse and vectorized else matrix


def _constant(matrix: Any, t: Any, *_: Any) -> Any:
    """Return a matrix, or a stack of it for an array of times."""
    return matrix if np.ndim(t) == 0 else np.broadcast_to(matrix, (*t.shape, *matrix.shape))


def derivative_of(
    function: Any, name: str, frame: Frame, shape: tuple[int, ...], vectorized: bool,
    inputs: Inputs | None, kind: type[Derivative] = Derivative,
) -> Derivative | None:  # fmt: skip
    """Return the user's ``function`` as a derivative after checking it, None for None."""
    compiled = compiled_rhs(function, name)
    if compiled is not None and vectorized:
        raise ValueError(f"vectorized must be False for a compiled {name}, which takes one point")
    if compiled is None:
        if function is None:
            return None
        if is_matrix(function):
            function = partial(_constant, _read_matrix(function, name, shape, vectorized))
        elif not callable(function):
            raise TypeError(f"{name} must be callable as {name}(t, y), got {function!r}")
    if isinstance(frame, PhaseSpace) and kind is Derivative:
        # f returns forces, and derivatives would be those of all coefficients
        raise ValueError(
            f"{name} must be None on a phase space, where derivatives are differences, got "
            f"{function!r}"
        )
    if compiled is None and inputs is not None:
        function = WithInput(function)
    return kind(name, compiled or function, frame, shape, vectorized)


@dataclass(frozen=True, eq=False)
class Jacobian:
    """The Jacobian of a right-hand side.

    Compiled code factors dense matrices by LAPACK; sparse ones are kept and factored here.
    """

    derivative: Derivative
    sparse: bool = False  # whether the function returns sparse matrices of SciPy
    constant: bool = False  # whether a matrix was given, which isn't counted as evaluated
    lanes: int = 1  # how many members are integrated at the same time
    # the sparse matrix and its factors by member, the latest used last
    kept: dict[int, list[Any]] = field(default_factory=dict)

    def value(self, rhs: Rhs, member: int, t: float, y: Points) -> Any:
        """Return the matrix at a point, after checking it."""
        if rhs.vectorized:
            row = self.derivative(np.array([t]), y[None], rhs.extra.arguments(np.array([member])))
            return row[0]
        arguments = rhs.extra.arguments(member)
        if not self.sparse:
            data = data_at(t, arguments, rhs.extra.parameters is not None)
            own = rhs.user_address if isinstance(rhs, CompiledRhs) else 0
            return self.derivative(t, y, arguments, own if data is None else data.ctypes.data)
        value, shape = self.derivative.function(t, read_only(y), *arguments), self.derivative.shape
        if getattr(value, "shape", None) != shape:
            raise ValueError(f"jac must return a matrix of shape {shape}, got {value!r}")
        matrix = value.tocsc()
        if matrix.dtype.kind not in "biuf":
            raise ValueError(f"jac must return real numbers, got {value!r} at {time_text(t)}")
        matrix = matrix.astype(np.float64)
        if not np.isfinite(matrix.data).all():
            raise ValueError(f"jac must return finite numbers, got {value!r} at {time_text(t)}")
        return matrix

    def evaluate(self, rhs: Rhs, member: int, t: float, y: Points, slope: Array) -> Array:
        """Return the matrix column by column, or nothing if it is sparse and kept here."""
        matrix = self.value(rhs, member, t, y)
        if not self.sparse:
            return np.asarray(matrix.T)
        from scipy.sparse import csc_array

        # stages are coordinates u with u' = dexp⁻¹_u f, whose derivative by u is -[u, f] / 2
        brackets = self.derivative.frame.bracket(-0.5 * np.eye(len(slope)), slope).T
        while len(self.kept) >= self.lanes and member not in self.kept:
            del self.kept[next(iter(self.kept))]
        self.kept[member] = [csc_array(matrix + csc_array(brackets))]
        return np.zeros(1)

    def factor(self, member: int, shifts: tuple[complex, ...]) -> Array:
        """Factor the matrix subtracted from multiples of the identity; return 1 if it fails."""
        from scipy.sparse import eye_array
        from scipy.sparse.linalg import splu

        matrix = self.kept.pop(member)[0]
        self.kept[member] = [matrix]  # now the latest used
        identity: Any = eye_array(matrix.shape[0], format="csc")
        try:
            self.kept[member] += [splu(shift * identity - matrix) for shift in shifts]
        except RuntimeError:  # a singular matrix
            return np.ones(1)
        return np.zeros(1)

    def solve(self, member: int, b: Array) -> Array:
        """Return the solution of the real system, or of the complex one if b has 2 n numbers."""
        _, real_solver, complex_solver = self.kept[member]
        n = self.derivative.frame.dim
        if len(b) == n:
            return np.asarray(real_solver.solve(b))
        x = complex_solver.solve(b[:n] + 1j * b[n:])
        return np.concatenate([x.real, x.imag])


def jacobian_of(
    jac: Any, frame: Frame, table: MethodTable, rhs: Rhs, t: float, y: Points
) -> Jacobian:
    """Return the Jacobian that ``jac`` evaluates, after calling it at the initial point."""
    if table.kind is not Kind.COLLOCATION:
        raise ValueError(
            f"method must be 'RadauIIA5' with jac but without derivatives, got {table!r}"
        )
    constant, shape = is_matrix(jac), (frame.dim, frame.dim)
    derivative = derivative_of(jac, "jac", frame, shape, rhs.vectorized, rhs.extra.inputs)
    assert derivative is not None
    sparse = False
    if not (rhs.vectorized or isinstance(derivative.function, CompiledRhs)):
        try:
            sparse = hasattr(derivative.function(t, y.copy(), *rhs.extra.arguments(0)), "tocsc")
        except TypeError as error:
            error.add_note("jac is given the arguments of f")
            raise
    jacobian = Jacobian(derivative, sparse, constant)
    jacobian.value(rhs, 0, t, y.copy())
    return jacobian
