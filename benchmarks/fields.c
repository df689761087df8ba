#include <math.h>

// Right-hand sides in C, and the function of an event.

// The heavy top, on SO(3) x R^3: attitude and momentum in body axes. The data are the inverses of the
// three moments of inertia, and mass times gravity times length.
int heavy_top(double t, const double *y, double *f, void *user_data)
{
    const double *constants = user_data, *m = y + 9;
    const double mgl = constants[3];
    (void)t;
    for (int i = 0; i < 3; i++)
        f[i] = constants[i] * m[i];
    f[3] = m[1] * f[2] - m[2] * f[1] + mgl * y[7];
    f[4] = m[2] * f[0] - m[0] * f[2] - mgl * y[6];
    f[5] = m[0] * f[1] - m[1] * f[0];
    return 0;
}

// Its derivatives along the fields, row by row
int heavy_top_jac(double t, const double *y, double *jac, void *user_data)
{
    const double *c = user_data, *m = y + 9;
    (void)t;
    for (int i = 0; i < 36; i++)
        jac[i] = 0.0;
    for (int i = 0; i < 3; i++)
        jac[7 * i + 3] = c[i];
    jac[18] = jac[25] = c[3] * y[8];
    jac[20] = -c[3] * y[6];
    jac[26] = -c[3] * y[7];
    jac[22] = m[2] * (c[2] - c[1]);
    jac[23] = m[1] * (c[2] - c[1]);
    jac[27] = m[2] * (c[0] - c[2]);
    jac[29] = m[0] * (c[0] - c[2]);
    jac[33] = m[1] * (c[1] - c[0]);
    jac[34] = m[0] * (c[1] - c[0]);
    return 0;
}

// A body that no torque acts on, a unit quaternion and the momentum in body axes. The data are the
// inverses of the moments of inertia.
int free_body(double t, const double *y, double *f, void *user_data)
{
    const double *inverse = user_data, *m = y + 4;
    (void)t;
    for (int i = 0; i < 3; i++)
        f[i] = inverse[i] * m[i];
    f[3] = m[1] * f[2] - m[2] * f[1];
    f[4] = m[2] * f[0] - m[0] * f[2];
    f[5] = m[0] * f[1] - m[1] * f[0];
    return 0;
}

// An event of that body: the axis of the largest moment lies in the horizontal plane.
double level(double t, const double *y, void *user_data)
{
    (void)t, (void)user_data;
    return y[3] * y[3] + y[2] * y[2] - y[0] * y[0] - y[1] * y[1];
}

// Nine rates that depend on time alone, for rotations with two vectors
int motion(double t, const double *y, double *f, void *user_data)
{
    (void)y, (void)user_data;
    for (int i = 0; i < 9; i++)
        f[i] = sin((1.0 + 0.5 * i) * t) + 0.2;
    return 0;
}
