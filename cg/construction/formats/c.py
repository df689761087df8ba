"""A step in C: a header file."""

from collections.abc import Mapping

from cg.construction.formats.digits import Numbers
from cg.construction.formats.language import Language
from cg.construction.formats.mechanics import STEP, parts_of
from cg.construction.formats.program import Program, identifier
from cg.construction.formats.text import array, comment, fill, reals
from cg.frames.base import Frame
from cg.frames.block_kinds import SCALAR_FIRST, SPACE_AXES
from cg.frames.phase_space import PhaseSpace
from cg.support.shared_numbers import BlockKind

_TOP = """@heading@

#ifndef @NAME@_H
#define @NAME@_H

#include <math.h>

/* Numbers are doubles. For another type, define these macros before including this file, e.g.
   #define @NAME@_REAL long double
   #define @NAME@_NUMBER(x) x##L
   #define @NAME@_MATH(function) function##l
   The last one is for functions of math.h, which only flows of rotations need. */
#ifndef @NAME@_REAL
#define @NAME@_REAL double
#define @NAME@_NUMBER(x) x
#define @NAME@_MATH(function) function
#endif
"""

_HEADER = (
    _TOP
    + """
/* f(t, y, f, data) writes the m coefficients of the frame's fields at the point y to f.
   All callbacks return 0; another value ends the step, which returns that value. */
typedef int (*@name@_f)(@NAME@_REAL t, const @NAME@_REAL *y, @NAME@_REAL *f, void *data);

/* flow(v, y, data) moves the point y along the time-1 flow of the field with coefficients v. */
typedef int (*@name@_flow)(const @NAME@_REAL *v, @NAME@_REAL *y, void *data);
@typedef@
@tables@
/* Size of the work array of a step, for points of n numbers and m fields */
#define @NAME@_WORK(n, m) (@slots@ * (n) + @rows@ * (m))

/* Advances the point y, of n numbers, by a step of size h from time t.@remark@ */
static inline int @name@_step(@name@_f f, @name@_flow flow, @dexpinv@void *data, int n, int m,
    @NAME@_REAL t, @NAME@_REAL h, @NAME@_REAL *y, @second@@NAME@_REAL *work)
{
    @NAME@_REAL *fields = work + @slots@ * n, *v = fields + @stages@ * m;
    int i, k, stage, move, done = 0, status;
    for (i = 0; i < n; i++) work[i] = y[i];
    for (stage = 0; stage <= @stages@; stage++) {
        int end = stage < @stages@ ? @name@_before[stage] : @moves@;
        for (move = done; move < end; move++) {
            const @NAME@_REAL *from = work + @name@_origin[move] * n;
            @NAME@_REAL *to = work + @name@_target[move] * n;
@v@            for (k = @name@_first[move]; k < @name@_first[move + 1]; k++) {
                const @NAME@_REAL weight = h * @name@_weight[k];
                const @NAME@_REAL *field = fields + @name@_term_stage[k] * m;
                for (i = 0; i < m; i++)
                    v[i] = k == @name@_first[move] ? weight * field[i] : v[i] + weight * field[i];
            }
            for (i = 0; i < n; i++) to[i] = from[i];
            status = flow(v, to, data);
            if (status) return status;
        }
        done = end;
        if (stage < @stages@) {
            status = f(t + @name@_c[stage] * h, work + @name@_slot[stage] * n, fields + stage * m,
                data);
            if (status) return status;
@derivative@        }
    }
    for (i = 0; i < n; i++) y[i] = work[@result@ * n + i];
@output@    return 0;
}

@flows@#endif
"""
)

_DEXPINV = """
/* dexpinv(u, v, data) replaces the coefficients v of the velocity of the point with coordinates
   u by the derivative of the coordinates. */
typedef int (*@name@_dexpinv)(const @NAME@_REAL *u, @NAME@_REAL *v, void *data);
"""

_DERIVATIVE = """            if (@name@_slot[stage]) {
                status = dexpinv(work + @slots@ * n + (@stages@ + @name@_slot[stage]) * m,
                    fields + stage * m, data);
                if (status) return status;
            }
"""

_ALGEBRA = {
    "typedef": _DEXPINV,
    "dexpinv": "@name@_dexpinv dexpinv, ",
    "v": "            v = fields + (@stages@ + @name@_target[move]) * m;\n",
    "derivative": _DERIVATIVE,
}

_PAIR = {
    "output": """    if (second)
        for (i = 0; i < n; i++) second[i] = work[@second_slot@ * n + i];
""",
    "remark": """
   Writes the second result, of order @lower@, to second unless that is a null pointer.""",
    "second": "@NAME@_REAL *second, ",
}

_ERROR = """    if (error)
        for (k = 0; k < @errors@; k++)
            for (i = 0; i < m; i++) {
                @NAME@_REAL sum = (h * @name@_error[k * @stages@]) * fields[i];
                for (stage = 1; stage < @stages@; stage++)
                    sum = sum + (h * @name@_error[k * @stages@ + stage]) * fields[stage * m + i];
                error[k * m + i] = sum;
            }
"""

_ERROR_REMARKS = {
    1: """
   Writes the m coefficients of its error to error unless that is a null pointer: the
   coefficients of the field whose flow joins the two results.""",
    2: """
   Writes the m coefficients of its error e, and the m of e_3, to error unless that is a null
   pointer; the estimate is |e|^2 / sqrt(|e|^2 + 0.01 |e_3|^2).""",
}

_FLOWS = """/* Points of @frame@: numbers of a point, and of its coefficients */
enum { @NAME@_N = @n@, @NAME@_M = @m@ };
@parts@
/* The flow of the frame */
static inline int @name@_frame_flow(const @NAME@_REAL *v, @NAME@_REAL *y, void *data)
{
    @NAME@_REAL q[4];
@moves@
    (void)q; (void)data;
    return 0;
}
@dexpinvs@
"""

_FRAME_DEXPINV = """
/* dexpinv of the frame */
static inline int @name@_frame_dexpinv(const @NAME@_REAL *u, @NAME@_REAL *v, void *data)
{
@changes@    (void)u; (void)v; (void)data;
    return 0;
}
"""

_QUATERNION = """
/* Writes the unit quaternion (x, y, z, w) of a rotation by the vector v to q. */
static inline void @name@_quaternion(const @NAME@_REAL *v, @NAME@_REAL *q)
{
    const @NAME@_REAL half = @NAME@_MATH(sqrt)(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / 2;
    const @NAME@_REAL scale = half > 0 ? @NAME@_MATH(sin)(half) / (2 * half) : @NAME@_NUMBER(0.5);
    int i;
    for (i = 0; i < 3; i++) q[i] = scale * v[i];
    q[3] = @NAME@_MATH(cos)(half);
}

/* Writes the cross product of u and v to w. */
static inline void @name@_cross(const @NAME@_REAL *u, const @NAME@_REAL *v, @NAME@_REAL *w)
{
    w[0] = u[1] * v[2] - u[2] * v[1];
    w[1] = u[2] * v[0] - u[0] * v[2];
    w[2] = u[0] * v[1] - u[1] * v[0];
}
"""

_TURN = """
/* Turns the quaternion with the vector part u and the scalar part w by q: from the left where side
   is 1, from the right where it is -1. The last lines remove rounding off length one. */
static inline void @name@_turn(const @NAME@_REAL *q, int side, @NAME@_REAL *u, @NAME@_REAL *w)
{
    @NAME@_REAL a[3], scalar, square = 0;
    int i;
    @name@_cross(q, u, a);
    scalar = *w * q[3] - q[0] * u[0] - q[1] * u[1] - q[2] * u[2];
    for (i = 0; i < 3; i++) u[i] = *w * q[i] + q[3] * u[i] + (side > 0 ? a[i] : -a[i]);
    *w = scalar;
    for (i = 0; i < 3; i++) square = square + u[i] * u[i];
    square = (3 - (square + scalar * scalar)) / 2;
    for (i = 0; i < 3; i++) u[i] = square * u[i];
    *w = square * scalar;
}
"""

_ROTATE = """
/* Rotates vectors, the k-th of which has entries y[k * first + i * next], by q, or back where side
   is -1; then a step towards orthonormal vectors removes rounding. */
static inline void @name@_rotate(const @NAME@_REAL *q, int side, int count, int first, int next,
    @NAME@_REAL *y)
{
    @NAME@_REAL p[3], a[3], b[3], old[9], product;
    int i, j, k;
    for (k = 0; k < count; k++) {
        for (i = 0; i < 3; i++) p[i] = y[k * first + i * next];
        @name@_cross(q, p, a);
        @name@_cross(q, a, b);
        for (i = 0; i < 3; i++)
            old[3 * k + i] = p[i] + 2 * (side > 0 ? q[3] * a[i] : -q[3] * a[i]) + 2 * b[i];
    }
    for (k = 0; k < count; k++) {
        for (i = 0; i < 3; i++) p[i] = 3 * old[3 * k + i] / 2;
        for (j = 0; j < count; j++) {
            product = 0;
            for (i = 0; i < 3; i++) product = product + old[3 * k + i] * old[3 * j + i];
            for (i = 0; i < 3; i++) p[i] = p[i] - product * old[3 * j + i] / 2;
        }
        for (i = 0; i < 3; i++) y[k * first + i * next] = p[i];
    }
}
"""

_ROTATION_DEXPINV = """
/* dexpinv of rotations, from the left where side is 1, from the right where it is -1 */
static inline void @name@_rotation_dexpinv(const @NAME@_REAL *u, int side, @NAME@_REAL *v)
{
    const @NAME@_REAL square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
    const @NAME@_REAL half = @NAME@_MATH(sqrt)(square) / 2;
    const @NAME@_REAL factor =
        square > 0 ? (1 - half / @NAME@_MATH(tan)(half)) / square : @NAME@_NUMBER(1.0) / 12;
    @NAME@_REAL a[3], b[3];
    int k;
    @name@_cross(u, v, a);
    @name@_cross(u, a, b);
    for (k = 0; k < 3; k++) v[k] = v[k] + (side > 0 ? -a[k] : a[k]) / 2 + factor * b[k];
}
"""


def with_flows(text: str, program: Program, frame: Frame | None) -> str:
    """Return a header with the flows of a frame, or without flows."""
    flows = "" if frame is None else _Flows(frame).text(_FLOWS, program.name, program.on_algebra)
    return fill(text, {"flows": flows})


def with_free_motion(numbers: Numbers, title: str, frame: PhaseSpace) -> str:
    """Return the header of a step of a splitting method for mechanical systems."""
    flows, name = _Flows(frame), identifier(numbers.method.name)
    bodies = parts_of(numbers, name, frame, flows.moves, flows.turns)
    heading = comment(f"{title}\n{numbers.method.source}".strip(), "//")
    text = fill(_TOP + STEP + "\n#endif\n", {"heading": heading, **bodies})
    return flows.text(text, name, False)


class _Flows:
    """The flows of the blocks of a frame: rotations, unit vectors and vectors."""

    def __init__(self, frame: Frame) -> None:
        self.frame = repr(frame)
        self.moves: list[str] = []  # along the vector v
        self.turns: list[str] = []  # by the quaternion q
        self._changes, self._kinds, y, v = [], set(), 0, 0
        for kind, n, options, *_ in frame.compiled_blocks() or [(0, 0, 0)]:
            side = 1 if options & SPACE_AXES or kind == BlockKind.SPHERE else -1
            match kind:
                case BlockKind.EUCLIDEAN:
                    move = f"for (int i = 0; i < {n}; i++) y[{y} + i] = y[{y} + i] + v[{v} + i];"
                    size = dim = n
                case BlockKind.QUATERNION:
                    vector, scalar = (y + 1, y) if options & SCALAR_FIRST else (y, y + 3)
                    move = f"@name@_turn(q, {side}, y + {vector}, y + {scalar});"
                    size, dim = 4, 3
                case BlockKind.SO3 | BlockKind.SPHERE:
                    size, dim = (9, 3) if kind == BlockKind.SO3 else (3, 3)
                    steps = "1, 3" if kind == BlockKind.SO3 and side > 0 else "3, 1"
                    move = f"@name@_rotate(q, {side}, {size // 3}, {steps}, y + {y});"
                case _:
                    raise ValueError(
                        "frame must be UnitQuaternion, SO3, Sphere(2), Euclidean, or a product or "
                        f"power of these, got {frame!r}"
                    )
            self.turns.append(move)
            if kind != BlockKind.EUCLIDEAN:
                move = f"@name@_quaternion(v + {v}, q);\n    {move}"
                self._changes.append(f"@name@_rotation_dexpinv(u + {v}, {side}, v + {v});")
            self.moves.append(move)
            self._kinds.add(kind)
            y, v = y + size, v + dim
        self._size, self._dim = y, v

    def text(self, text: str, name: str, on_algebra: bool) -> str:
        """Return a text with the flows."""
        rotations = {BlockKind.SO3, BlockKind.SPHERE}
        parts = _QUATERNION if self._kinds - {BlockKind.EUCLIDEAN} else ""
        parts += _TURN if BlockKind.QUATERNION in self._kinds else ""
        parts += _ROTATE if self._kinds & rotations else ""
        if on_algebra and self._changes:
            parts += _ROTATION_DEXPINV
        return fill(text, {
            "moves": "\n".join(f"    {line}" for line in self.moves),
            "dexpinvs": _FRAME_DEXPINV if on_algebra else "",
            "changes": "".join(f"    {line}\n" for line in self._changes),
            "parts": parts, "n": self._size, "m": self._dim, "frame": self.frame,
            "name": name, "NAME": name.upper(),
        })  # fmt: skip


def _tables(program: Program, integers: Mapping[str, list[str]]) -> str:
    numbers = {"weight": program.term_weights, "c": program.c}
    if program.errors:
        numbers["error"] = tuple(weight for row in program.errors for weight in row)
    lines = [
        "/* Slots hold points; slot 0 holds the initial one. Each stage has an abscissa c, the",
        "   number of moves before it, and a slot. Each move is a flow from one slot to another,",
        "   along the weighted sum of the fields at stages. */",
    ]
    for name, entries in integers.items():
        lines.append(array(f"static const int {program.name}_{name}", entries))
    for name, texts in numbers.items():
        lines.append(reals(program.name, name, texts))
    return "\n".join(lines)


C = Language(
    _HEADER, mark="//", tables=_tables,
    pair=_PAIR,
    error={"output": _ERROR, "second": "@NAME@_REAL *error, "}, remarks=_ERROR_REMARKS,
    algebra=_ALGEBRA,
)  # fmt: skip
