"""A step of a splitting method in C, with the free motion of rigid bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cg.construction.formats.digits import Numbers
from cg.construction.formats.text import fill, reals
from cg.frames.phase_space import PhaseSpace

STEP = """
/* f(t, y, f, data) writes the @NAME@_M forces at the point y to f; the last numbers of a point are
   the momenta. Another value than 0 ends the step, which returns it. */
typedef int (*@name@_f)(@NAME@_REAL t, const @NAME@_REAL *y, @NAME@_REAL *f, void *data);

/* Drifts and kicks, as fractions of a step */
@tables@

/* Points of @frame@: numbers of a point, and of its forces */
enum { @NAME@_N = @n@, @NAME@_M = @m@ / 2 };
@parts@@free_motion@
/* Moves all bodies freely. */
static inline void @name@_drift(@NAME@_REAL time, @NAME@_REAL *y)
{
    @NAME@_REAL *p = y + @NAME@_N - @NAME@_M, v[@NAME@_M], q[4];
@drift@
    (void)v; (void)q;
}

/* Advances the point y by a step of size h from time t. */
static inline int @name@_step(@name@_f f, void *data, @NAME@_REAL t, @NAME@_REAL h, @NAME@_REAL *y)
{
    @NAME@_REAL *p = y + @NAME@_N - @NAME@_M, force[@NAME@_M];
    int i, stage, status;
    for (stage = 0; stage < @stages@; stage++) {
        if (@name@_d[stage] < 0 || @name@_d[stage] > 0) @name@_drift(h * @name@_d[stage], y);
        t = t + h * @name@_d[stage];
        status = f(t, y, force, data);
        if (status) return status;
        for (i = 0; i < @NAME@_M; i++) p[i] = p[i] + h * @name@_k[stage] * force[i];
    }
    @name@_drift(h * @name@_d[@stages@], y);
    return 0;
}
"""

FREE_MOTION = """
/* The free motion of a rigid body is exact for every spin and time. In principal axes the direction
   of the momentum is (a1 cn u, a2 sn u, a dn u), with Jacobi's functions of u, which is linear in
   time; the body turns by the mean of 1 / (1 + a dn), an elliptic integral of the third kind. */
typedef struct { @NAME@_REAL m, rest, a, s, c, d; } @name@_motion;

/* Writes sn, cn and dn of u to f, for m and rest = 1 - m, by Landen's transformation. */
static inline void @name@_jacobi(@NAME@_REAL u, @NAME@_REAL m, @NAME@_REAL rest, @NAME@_REAL *f)
{
    @NAME@_REAL modulus[20], square = m, k = @NAME@_MATH(sqrt)(rest), v = u, s, c;
    int n = 0;
    if (rest < @NAME@_NUMBER(5e-17)) {
        f[0] = @NAME@_MATH(tanh)(u);
        f[1] = f[2] = 1 / @NAME@_MATH(cosh)(u);
        return;
    }
    while (square > @NAME@_NUMBER(4e-9) && n < 20) {
        modulus[n] = square / ((1 + k) * (1 + k));
        v = v * (1 + k) / 2;
        k = 2 * @NAME@_MATH(sqrt)(k) / (1 + k);
        square = modulus[n] * modulus[n];
        n++;
    }
    s = @NAME@_MATH(sin)(v);
    c = @NAME@_MATH(cos)(v);
    f[2] = 1 - square / 2 * s * s;
    k = square / 4 * (v - s * c);
    f[0] = s - k * c;
    f[1] = c + k * s;
    while (n-- > 0) {
        s = modulus[n] * f[0] * f[0];
        f[1] = f[1] * f[2] / (1 + s);
        f[0] = (1 + modulus[n]) * f[0] / (1 + s);
        f[2] = (1 - s) / (1 + s);
    }
}

/* Moves the functions by an argument with the functions f. */
static inline void @name@_add(@name@_motion *x, const @NAME@_REAL *f)
{
    const @NAME@_REAL s = x->s, c = x->c, d = x->d, square = f[0] * f[0];
    const @NAME@_REAL less = x->m * s * s * square;
    const @NAME@_REAL rest_c = square / (1 + f[1]), rest_d = x->m * square / (1 + f[2]);
    x->s = s + (f[0] * c * d - s * (rest_c + f[1] * rest_d - less)) / (1 - less);
    x->c = c - (s * d * f[0] * f[2] + c * (rest_c - less)) / (1 - less);
    x->d = d - (x->m * s * c * f[0] * f[1] + d * (rest_d - less)) / (1 - less);
}

@gauss@
/* Moves the functions by u; returns the integral of 1 / (1 + a dn), by Gauss's formula. */
static inline @NAME@_REAL @name@_pieces(@name@_motion *x, @NAME@_REAL u)
{
    const long pieces =
        (long)@NAME@_MATH(fmin)(@NAME@_MATH(fabs)(u) / @NAME@_NUMBER(1.1), @NAME@_NUMBER(1e9)) + 1;
    const @NAME@_REAL half = u / (2 * (@NAME@_REAL)pieces);
    @NAME@_REAL f[3], sum = 0;
    long i;
    int k;
    @name@_jacobi(half, x->m, x->rest, f);
    for (i = 0; i < pieces; i++) {
        @NAME@_REAL d, c2, s2;
        if (!(x->c < 0 || x->c > 0 || x->d > 0)) return sum + 2 * half * (@NAME@_REAL)(pieces - i);
        @name@_add(x, f);
        d = x->a * x->d;
        c2 = x->m * x->a * x->c * x->a * x->c;
        s2 = x->m * x->s * x->s;
        for (k = 0; k < 7; k++) {
            const @NAME@_REAL y = f[0] * f[0] * @name@_node[k], other = 1 - s2 * y;
            const @NAME@_REAL dn = @NAME@_MATH(sqrt)(1 - x->m * y);
            sum = sum + 2 * f[0] * @name@_weight[k] * (other + d * dn)
                / ((other + 2 * d * dn + (d * d - c2 * y)) * (dn * @NAME@_MATH(sqrt)(1 - y)));
        }
        @name@_add(x, f);
    }
    return sum;
}

/* Moves the functions by u, whole periods at once; returns the mean of 1 / (1 + a dn). */
static inline @NAME@_REAL @name@_mean(@name@_motion *x, @NAME@_REAL u)
{
    @NAME@_REAL a = 1, b = @NAME@_MATH(sqrt)(x->rest), whole = 0, rest = u;
    int i;
    if (!(u < 0 || u > 0)) return 1 / (1 + x->a * x->d);
    if (@NAME@_MATH(fabs)(u) > @NAME@_NUMBER(1.1) && b > 0) {
        @name@_motion start = *x;
        start.s = 0;
        start.c = start.d = 1;
        for (i = 0; i < 10; i++) {
            const @NAME@_REAL mean = (a + b) / 2;
            b = @NAME@_MATH(sqrt)(a * b);
            a = mean;
        }
        a = @NAME@_NUMBER(3.14159265358979323846264338327950288) / (2 * a);
        b = @NAME@_MATH(floor)(u / (4 * a) + @NAME@_NUMBER(0.5));
        if (b < 0 || b > 0) whole = 4 * b * @name@_pieces(&start, a);
        rest = u - 4 * b * a;
    }
    return (whole + @name@_pieces(x, rest)) / u;
}

/* Moves the momentum p of a body freely, and writes the quaternion (x, y, z, w) of its turn to q.
   The body is its principal axes, one after the other, the inverse moments of inertia J1 > J2 > J3,
   and J1 - J2, J2 - J3, J1 - J3. */
static inline void @name@_turn_freely(const @NAME@_REAL *body, @NAME@_REAL time, @NAME@_REAL *p,
    @NAME@_REAL *q)
{
    const @NAME@_REAL *gap = body + 12;
    const @NAME@_REAL size = @NAME@_MATH(sqrt)(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    @NAME@_REAL n[3], z[3], g[4], r[2], x, w, other, third, ratio, a1, scale, sine, angle;
    @NAME@_REAL way = 1, turn = 1;
    @name@_motion motion = {0, 1, 0, 0, 1, 1};
    int i, swap;
    q[0] = q[1] = q[2] = 0;
    q[3] = 1;
    if (!(size > 0)) return;
    for (i = 0; i < 3; i++)
        n[i] = (body[3 * i] * p[0] + body[3 * i + 1] * p[1] + body[3 * i + 2] * p[2]) / size;
    x = n[0] * n[0] * gap[0];
    w = n[2] * n[2] * gap[1];
    swap = x > w || (!(x < w) && gap[0] > gap[1]);
    if (swap) { /* the momentum goes around the axis of the smallest moment: half a turn */
        x = n[0];
        n[0] = n[2];
        n[1] = -n[1];
        n[2] = x;
        way = -1;
    }
    if (n[2] < 0) {
        turn = -1;
        n[1] = -n[1];
        n[2] = -n[2];
    }
    third = swap ? gap[0] : gap[1];
    other = swap ? gap[1] : gap[0];
    ratio = @NAME@_MATH(sqrt)(gap[2] / third);
    a1 = @NAME@_MATH(sqrt)(n[0] * n[0] + n[1] / ratio * (n[1] / ratio));
    scale = n[2] * n[2] + n[1] * n[1] * (other / gap[2]);
    if (a1 > 0) {
        motion.s = n[1] / (ratio * a1);
        motion.c = n[0] / a1;
    }
    if (scale > 0) {
        motion.a = @NAME@_MATH(sqrt)(scale);
        motion.m = a1 * a1 * other / (scale * third);
        motion.rest = (n[2] * n[2] * third - n[0] * n[0] * other) / (scale * third);
        if (motion.rest < 0) motion.rest = 0;
        motion.d = n[2] / motion.a;
    }
    x = @name@_mean(&motion, way * size * time * motion.a * @NAME@_MATH(sqrt)(third * gap[2]));
    angle = size * time * ((swap ? body[9] : body[11]) + way * a1 * a1 * gap[2] * x) / 2;
    z[0] = a1 * motion.c;
    z[1] = a1 * ratio * motion.s;
    z[2] = motion.a * motion.d;
    /* the shortest rotation to n, a turn about the third axis, and the inverse of the one to z */
    scale = @NAME@_MATH(sqrt)(2 * (1 + n[2]));
    sine = @NAME@_MATH(sin)(angle) / scale;
    w = @NAME@_MATH(cos)(angle) / scale;
    g[0] = n[0] * sine - n[1] * w;
    g[1] = n[1] * sine + n[0] * w;
    g[2] = (1 + n[2]) * sine;
    g[3] = (1 + n[2]) * w;
    scale = @NAME@_MATH(sqrt)(2 * (1 + z[2]));
    r[0] = z[1] / scale;
    r[1] = -z[0] / scale;
    w = (1 + z[2]) / scale;
    n[0] = g[3] * r[0] + w * g[0] - g[2] * r[1];
    n[1] = turn * (g[3] * r[1] + w * g[1] + g[2] * r[0]);
    n[2] = turn * (w * g[2] + g[0] * r[1] - g[1] * r[0]);
    q[3] = w * g[3] - g[0] * r[0] - g[1] * r[1];
    z[1] = turn * z[1];
    z[2] = turn * z[2];
    scale = size * (3 - (z[0] * z[0] + z[1] * z[1] + z[2] * z[2])) / 2;
    for (i = 0; i < 3; i++) {
        const @NAME@_REAL first = body[swap ? 6 + i : i], last = body[swap ? i : 6 + i];
        q[i] = first * n[0] + way * body[3 + i] * n[1] + last * n[2];
        p[i] = scale * (first * z[0] + way * body[3 + i] * z[1] + last * z[2]);
    }
}
"""


def parts_of(
    numbers: Numbers, name: str, frame: PhaseSpace, moves: Sequence[str], turns: Sequence[str]
) -> dict[str, str]:
    """Return the parts of a header that depend on the method and the inertia.

    Blocks of the frame move along a vector v by ``moves``, and turn by a quaternion q by ``turns``.
    """
    if frame.gyroscopic is not None or frame.jointed:
        raise ValueError(
            "frame must be a phase space without gyroscopic forces, joints and constraints, got "
            f"{frame!r}"
        )
    values = [numbers.decimal(value) for value in numbers.values]
    tables = [reals(name, "d", values[::2]), reals(name, "k", values[1::2])]
    lines, motion = [], ""
    for k, body in enumerate(frame._bodies):
        first, size = body.vectors.start, body.vectors.stop - body.vectors.start
        if body.sphere:
            raise ValueError(f"frame must be a phase space without spheres, got {frame!r}")
        if body.top is None:
            constants, v = body.velocity(np.eye(size)), f"v[{first} + i]"
            lines.append(f"""for (int i = 0; i < {size}; i++) {{
        {v} = 0;
        for (int k = 0; k < {size}; k++)
            {v} = {v} + time * @name@_body{k}[{size} * i + k] * p[{first} + k];
    }}
    {moves[k]}""")
        else:
            constants, motion = np.concatenate([body.top[:9], body.top[18:]]), FREE_MOTION
            lines.append(
                f"@name@_turn_freely(@name@_body{k}, time, p + {first}, q);\n    {turns[k]}"
            )
        tables.append(reals(name, f"body{k}", map(repr, constants.ravel().tolist())))
    nodes, weights = np.polynomial.legendre.leggauss(14)
    gauss = [reals(name, "node", map(repr, (nodes[7:] ** 2).tolist()))]
    gauss += [reals(name, "weight", map(repr, weights[7:].tolist()))]
    return {
        "drift": "\n".join(f"    {line}" for line in lines),
        "tables": "\n".join(tables),
        "stages": str(numbers.method.stages),
        "free_motion": fill(motion, {"gauss": "\n".join(gauss)}),
    }
