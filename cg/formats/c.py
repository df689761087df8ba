"""A step in C: a header of its own."""

from __future__ import annotations

from collections.abc import Sequence

from .program import Program
from .text import comment, fill, real, wrapped

__all__ = ["to_c"]

_HEAD = """
#ifndef @NAME@_H
#define @NAME@_H

/* Numbers are doubles. For others define both before this file is included, such as
   #define @NAME@_REAL long double
   #define @NAME@_NUMBER(x) x##L */
#ifndef @NAME@_REAL
#define @NAME@_REAL double
#define @NAME@_NUMBER(x) x
#endif

/* f(t, y, f, data) writes the m coefficients of the frame's fields at the point y.
   It and those below return 0, or another number that ends the step and is returned by it. */
typedef int (*@name@_f)(@NAME@_REAL t, const @NAME@_REAL *y, @NAME@_REAL *f, void *data);

/* flow(v, y, data) moves the point y along the time-1 flow of the field with coefficients v. */
typedef int (*@name@_flow)(const @NAME@_REAL *v, @NAME@_REAL *y, void *data);
"""

_DEXPINV = """
/* dexpinv(u, v, data) replaces the coefficients v with which a point of coordinates u moves by
   the derivative of these coordinates. */
typedef int (*@name@_dexpinv)(const @NAME@_REAL *u, @NAME@_REAL *v, void *data);
"""

_STEP = """
/* Numbers of the work space of a step, for points of n numbers and m fields */
#define @NAME@_WORK(n, m) (@slots@ * (n) + @rows@ * (m))

/* Moves the point y, of n numbers, by a step of size h from time t.@says@ */
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

#endif
"""

_DERIVATIVE = """            if (@name@_slot[stage]) {
                status = dexpinv(work + @slots@ * n + (@stages@ + @name@_slot[stage]) * m,
                    fields + stage * m, data);
                if (status) return status;
            }
"""

_PAIR = """    if (second)
        for (i = 0; i < n; i++) second[i] = work[@second_slot@ * n + i];
"""

_ERROR = """    if (error)
        for (k = 0; k < @errors@; k++)
            for (i = 0; i < m; i++) {
                @NAME@_REAL sum = (h * @name@_error[k * @stages@]) * fields[i];
                for (stage = 1; stage < @stages@; stage++)
                    sum = sum + (h * @name@_error[k * @stages@ + stage]) * fields[stage * m + i];
                error[k * m + i] = sum;
            }
"""

_SAYS_PAIR = """
   The second result, of order @lower@, is written to second unless that is a null pointer."""

_SAYS_ERRORS = {
    1: """
   The m coefficients of its error are written to error unless that is a null pointer:
   those of the field by which the two results differ.""",
    2: """
   The m coefficients of its error e, and m more of e_3, are written to error unless that is a
   null pointer; the estimate is |e|^2 / sqrt(|e|^2 + 0.01 |e_3|^2).""",
}


def to_c(program: Program) -> str:
    """Return a header."""
    output, says, second = "", "", ""
    real_type = f"{program.name.upper()}_REAL"
    if program.second is not None:
        output, says, second = _PAIR, _SAYS_PAIR, f"{real_type} *second, "
    elif program.errors:
        output, says = _ERROR, _SAYS_ERRORS[len(program.errors)]
        second = f"{real_type} *error, "
    v = "            v = fields + (@stages@ + @name@_target[move]) * m;\n"
    text = _HEAD + (_DEXPINV if program.on_algebra else "") + "\n" + _tables(program) + _STEP
    parts = {
        "v": v if program.on_algebra else "",
        "derivative": _DERIVATIVE if program.on_algebra else "",
        "dexpinv": f"{program.name}_dexpinv dexpinv, " if program.on_algebra else "",
        "says": says,
        "second": second,
        "output": output,
        "name": program.name,
        "NAME": program.name.upper(),
        "slots": program.slots,
        "stages": program.stages,
        "rows": program.stages + (program.slots if program.on_algebra else 1),
        "moves": len(program.moves),
        "result": program.result,
        "second_slot": program.second,
        "errors": len(program.errors),
        "lower": program.lower_order,
    }
    return comment(program.heading, "//") + "\n" + fill(text, parts)


def _tables(program: Program) -> str:
    numbers = {"weight": program.term_weights, "c": program.c}
    if program.errors:
        numbers["error"] = tuple(weight for row in program.errors for weight in row)
    lines = [
        "/* Points are kept in slots, of which 0 is the initial one. Of each stage: its abscissa",
        "   c, how many moves come before it, and its slot. Moves go from a slot to a slot, along",
        "   the sum of weights times fields at stages. */",
    ]
    for name, entries in program.integer_tables(slot=0, term=0).items():
        lines.append(_array(f"static const int {program.name}_{name}", entries))
    for name, texts in numbers.items():
        values = [f"{program.name.upper()}_NUMBER({real(text)})" for text in texts]
        declared = f"static const {program.name.upper()}_REAL {program.name}_{name}"
        lines.append(_array(declared, values))
    return "\n".join(lines)


def _array(declared: str, entries: Sequence[str]) -> str:
    entries = entries or ["0"]  # an array of C can't be empty
    return f"{declared}[{len(entries)}] = {{\n{wrapped(entries, '    ')}\n}};"
