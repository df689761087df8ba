"""A step in C: a header file."""

from collections.abc import Mapping, Sequence

from cg.construction.formats.language import Language
from cg.construction.formats.program import Program
from cg.construction.formats.text import real, wrapped

_HEADER = """@heading@

#ifndef @NAME@_H
#define @NAME@_H

#include <math.h>

/* Numbers are doubles. For another type, define these macros before including this file, e.g.
   #define @NAME@_REAL long double
   #define @NAME@_NUMBER(x) x##L
   #define @NAME@_MATH(function) function##l
   The last one is for the flows of rotations, which are left out without it. */
#ifndef @NAME@_REAL
#define @NAME@_REAL double
#define @NAME@_NUMBER(x) x
#define @NAME@_MATH(function) function
#endif

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

#ifdef @NAME@_MATH

/* Writes the unit quaternion (x, y, z, w) of a rotation by the vector v to q. */
static inline void @name@_quaternion(const @NAME@_REAL *v, @NAME@_REAL *q)
{
    const @NAME@_REAL half = @NAME@_MATH(sqrt)(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / 2;
    const @NAME@_REAL scale = half > 0 ? @NAME@_MATH(sin)(half) / (2 * half) : @NAME@_NUMBER(0.5);
    int i;
    for (i = 0; i < 3; i++) q[i] = scale * v[i];
    q[3] = @NAME@_MATH(cos)(half);
}

/* Flow on unit quaternions y = (x, y, z, w), n = 4: v is an angular velocity in axes of the body,
   m = 3. The last lines remove rounding errors of the length. */
static inline int @name@_quaternion_flow(const @NAME@_REAL *v, @NAME@_REAL *y, void *data)
{
    @NAME@_REAL q[4], p[4], scale;
    int i;
    (void)data;
    @name@_quaternion(v, q);
    for (i = 0; i < 4; i++) p[i] = y[i];
    y[0] = p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1];
    y[1] = p[3] * q[1] + p[1] * q[3] + p[2] * q[0] - p[0] * q[2];
    y[2] = p[3] * q[2] + p[2] * q[3] + p[0] * q[1] - p[1] * q[0];
    y[3] = p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2];
    scale = (3 - (y[0] * y[0] + y[1] * y[1] + y[2] * y[2] + y[3] * y[3])) / 2;
    for (i = 0; i < 4; i++) y[i] = scale * y[i];
    return 0;
}

/* Flow on rotation matrices y, row by row, n = 9: v is an angular velocity in axes of the body,
   m = 3. Rounding errors add up over steps. */
static inline int @name@_rotation_flow(const @NAME@_REAL *v, @NAME@_REAL *y, void *data)
{
    @NAME@_REAL q[4], p[3], a[3], b[3];
    int i, k;
    (void)data;
    @name@_quaternion(v, q);
    for (i = 0; i < 9; i += 3) {
        for (k = 0; k < 3; k++) p[k] = y[i + k];
        /* a row turns by the inverse rotation: p - 2 w a + 2 q x a with a = q x p */
        for (k = 0; k < 3; k++)
            a[k] = q[(k + 1) % 3] * p[(k + 2) % 3] - q[(k + 2) % 3] * p[(k + 1) % 3];
        for (k = 0; k < 3; k++)
            b[k] = q[(k + 1) % 3] * a[(k + 2) % 3] - q[(k + 2) % 3] * a[(k + 1) % 3];
        for (k = 0; k < 3; k++) y[i + k] = p[k] - 2 * q[3] * a[k] + 2 * b[k];
    }
    return 0;
}
@rotation_dexpinv@
#endif

#endif
"""

_DEXPINV = """
/* dexpinv(u, v, data) replaces the coefficients v of the velocity of the point with coordinates
   u by the derivative of the coordinates. */
typedef int (*@name@_dexpinv)(const @NAME@_REAL *u, @NAME@_REAL *v, void *data);
"""

_ROTATION_DEXPINV = """
/* dexpinv of both flows */
static inline int @name@_rotation_dexpinv(const @NAME@_REAL *u, @NAME@_REAL *v, void *data)
{
    const @NAME@_REAL square = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
    const @NAME@_REAL half = @NAME@_MATH(sqrt)(square) / 2;
    const @NAME@_REAL factor =
        square > 0 ? (1 - half / @NAME@_MATH(tan)(half)) / square : @NAME@_NUMBER(1.0) / 12;
    @NAME@_REAL a[3], b[3];
    int k;
    (void)data;
    for (k = 0; k < 3; k++)
        a[k] = u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
    for (k = 0; k < 3; k++)
        b[k] = u[(k + 1) % 3] * a[(k + 2) % 3] - u[(k + 2) % 3] * a[(k + 1) % 3];
    for (k = 0; k < 3; k++) v[k] = v[k] + a[k] / 2 + factor * b[k];
    return 0;
}
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
    "rotation_dexpinv": _ROTATION_DEXPINV,
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
        lines.append(_array(f"static const int {program.name}_{name}", entries))
    for name, texts in numbers.items():
        values = [f"{program.name.upper()}_NUMBER({real(text)})" for text in texts]
        declared = f"static const {program.name.upper()}_REAL {program.name}_{name}"
        lines.append(_array(declared, values))
    return "\n".join(lines)


def _array(declared: str, entries: Sequence[str]) -> str:
    entries = entries or ["0"]  # C has no empty arrays
    return f"{declared}[{len(entries)}] = {{\n{wrapped(entries, '    ')}\n}};"


C = Language(
    _HEADER, mark="//", tables=_tables,
    pair=_PAIR,
    error={"output": _ERROR, "second": "@NAME@_REAL *error, "}, remarks=_ERROR_REMARKS,
    algebra=_ALGEBRA,
)  # fmt: skip
