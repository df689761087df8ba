// The heavy top in C: its right-hand side, and a loop by hand that does nothing but integrate it.
#include <math.h>
#include <string.h>

enum { MOST_STAGES = 32, MOST_POINTS = 64, SIZE = 12 };

// constants: the inverses of the three moments of inertia, and mass times gravity times length
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

// The derivatives of the coefficients along the fields, row by row
int heavy_top_jac(double t, const double *y, double *jac, void *user_data)
{
    const double *c = user_data, *m = y + 9;
    (void)t;
    memset(jac, 0, 36 * sizeof(double));
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

// y <- y exp(hat v), by Rodrigues' formula
static void rotate(double *y, const double *v)
{
    const double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = sqrt(square);
    double a = 1.0, b = 0.5, r[9];
    if (angle > 1e-8) {
        const double half = sin(0.5 * angle);
        a = sin(angle) / angle;
        b = 2.0 * half * half / square;
    }
    r[0] = 1.0 - b * (v[1] * v[1] + v[2] * v[2]);
    r[4] = 1.0 - b * (v[0] * v[0] + v[2] * v[2]);
    r[8] = 1.0 - b * (v[0] * v[0] + v[1] * v[1]);
    r[1] = b * v[0] * v[1] - a * v[2];
    r[3] = b * v[0] * v[1] + a * v[2];
    r[2] = b * v[0] * v[2] + a * v[1];
    r[6] = b * v[0] * v[2] - a * v[1];
    r[5] = b * v[1] * v[2] - a * v[0];
    r[7] = b * v[1] * v[2] + a * v[0];
    for (int i = 0; i < 9; i += 3) {
        const double x0 = y[i], x1 = y[i + 1], x2 = y[i + 2];
        for (int j = 0; j < 3; j++)
            y[i + j] = x0 * r[j] + x1 * r[3 + j] + x2 * r[6 + j];
    }
}

static void flow(double *y, double weight, const double *f)
{
    const double v[3] = {weight * f[0], weight * f[1], weight * f[2]};
    rotate(y, v);
    for (int i = 0; i < 3; i++)
        y[9 + i] += weight * f[3 + i];
}

// y: steps + 1 points, of which the first is given; a: stages x stages, row by row
void integrate(int stages, const double *a, const double *b, double h, int steps,
               double *constants, double *y)
{
    double f[MOST_STAGES][6];
    for (int k = 0; k < steps; k++, y += SIZE) {
        double stage[SIZE], *next = y + SIZE;
        for (int i = 0; i < stages; i++) {
            memcpy(stage, y, sizeof stage);
            for (int j = 0; j < i; j++)
                if (a[i * stages + j] != 0.0)
                    flow(stage, h * a[i * stages + j], f[j]);
            heavy_top(0.0, stage, f[i], constants);
        }
        memcpy(next, y, sizeof stage);
        for (int j = 0; j < stages; j++)
            if (b[j] != 0.0)
                flow(next, h * b[j], f[j]);
    }
}

// The same of a tree of points: point m is reached from its parent, -1 for the start of a step, by the
// flow of a combination of stages (weights: points x stages), and stage i is evaluated at the point
// stage_points[i]. Points stand in the order in which they can be reached.
void integrate_points(int stages, const int *parents, const double *weights,
                      const int *stage_points, int result, double h, int steps,
                      double *constants, double *y)
{
    double f[MOST_STAGES][6], at[MOST_POINTS][SIZE];
    for (int k = 0; k < steps; k++, y += SIZE) {
        int reached = 0;
        for (int i = 0; i <= stages; i++) {
            const int wanted = i < stages ? stage_points[i] : result;
            for (; reached <= wanted; reached++) {
                const double *row = weights + reached * stages;
                double v[6] = {0.0}, *point = at[reached];
                for (int j = 0; j < i; j++)
                    if (row[j] != 0.0)
                        for (int l = 0; l < 6; l++)
                            v[l] += h * row[j] * f[j][l];
                memcpy(point, parents[reached] < 0 ? y : at[parents[reached]], sizeof at[0]);
                flow(point, 1.0, v);
            }
            if (i < stages)
                heavy_top(0.0, wanted < 0 ? y : at[wanted], f[i], constants);
        }
        memcpy(y + SIZE, at[result], sizeof at[0]);
    }
}
