// Right-hand sides for tests of the compiled integrator.
#include <stdatomic.h>
#include <unistd.h>

// f = constant + t slope + linear y; the data are m, n, constant, slope, and linear row by row.
int affine(double t, const double *y, double *f, void *user_data)
{
    const double *data = user_data;
    int m = (int)data[0], n = (int)data[1];
    const double *constant = data + 2, *slope = constant + m, *linear = slope + m;
    for (int i = 0; i < m; i++) {
        f[i] = constant[i] + t * slope[i];
        for (int j = 0; j < n; j++)
            f[i] += linear[i * n + j] * y[j];
    }
    return 0;
}

// The force of a heavy top on its attitude, a rotation matrix: the centre of mass is in the data.
int heavy(double t, const double *y, double *f, void *user_data)
{
    const double *c = user_data, *k = y + 6;
    f[0] = k[1] * c[2] - k[2] * c[1];
    f[1] = k[2] * c[0] - k[0] * c[2];
    f[2] = k[0] * c[1] - k[1] * c[0];
    return 0;
}

int growth(double t, const double *y, double *f, void *user_data)
{
    f[0] = y[0];
    return 0;
}

int square(double t, const double *y, double *f, void *user_data)
{
    f[0] = y[0] * y[0];
    return 0;
}

// It stops the integration with code 7 where time or the point has passed one half.
int stops(double t, const double *y, double *f, void *user_data)
{
    f[0] = 0.0;
    return t > 0.5 || y[0] > 0.5 ? 7 : 0;
}

int writes_nothing(double t, const double *y, double *f, void *user_data)
{
    return 0;
}

// At time zero it waits until two callers are there, for at most data[1] milliseconds.
int meets(double t, const double *y, double *f, void *user_data)
{
    struct { atomic_int callers; int patience; } *data = user_data;
    f[0] = 1.0;
    if (t != 0.0)
        return 0;
    atomic_fetch_add(&data->callers, 1);
    for (int i = 0; i < data->patience; i++) {
        if (atomic_load(&data->callers) >= 2)
            return 0;
        usleep(1000);
    }
    return 3;
}

// It says when it has been called many times.
int announced(double t, const double *y, double *f, void *user_data)
{
    static atomic_long calls;
    if (atomic_fetch_add(&calls, 1) == 1000 && write(1, "running\n", 8) != 8)
        return 1;
    f[0] = 0.0;
    return 0;
}

// As many zeros as the data say
int rests_all(double t, const double *y, double *f, void *user_data)
{
    const double *count = user_data;
    for (int i = 0; i < (int)*count; i++)
        f[i] = 0.0;
    return 0;
}

// y' = rate y, where the data are the rate and a time from which on it fails
int decays(double t, const double *y, double *f, void *user_data)
{
    const double *data = user_data;
    f[0] = data[0] * y[0];
    return t > data[1] ? 5 : 0;
}

// It breaks its promise not to change the point.
int overwrites(double t, const double *y, double *f, void *user_data)
{
    f[0] = -y[0];
    ((double *)y)[0] = 17.0;
    return 0;
}

// A heavy top: its attitude by rows, then its momentum; parameters are three moments of inertia and
// the weight. With the derivatives along the fields, and by the parameters.
int top(double t, const double *y, double *f, void *user_data)
{
    const double *p = user_data, *m = y + 9;
    double w[3];
    for (int i = 0; i < 3; i++)
        f[i] = w[i] = m[i] / p[i];
    f[3] = m[1] * w[2] - m[2] * w[1] + p[3] * y[7];
    f[4] = m[2] * w[0] - m[0] * w[2] - p[3] * y[6];
    f[5] = m[0] * w[1] - m[1] * w[0];
    return 0;
}

int top_jac(double t, const double *y, double *jac, void *user_data)
{
    const double *p = user_data, *m = y + 9;
    const double a = 1 / p[0], b = 1 / p[1], c = 1 / p[2];
    const double rows[6][6] = {
        {0, 0, 0, a, 0, 0},
        {0, 0, 0, 0, b, 0},
        {0, 0, 0, 0, 0, c},
        {p[3] * y[8], 0, -p[3] * y[6], 0, m[2] * (c - b), m[1] * (c - b)},
        {0, p[3] * y[8], -p[3] * y[7], m[2] * (a - c), 0, m[0] * (a - c)},
        {0, 0, 0, m[1] * (b - a), m[0] * (b - a), 0},
    };
    for (int i = 0; i < 36; i++)
        jac[i] = rows[i / 6][i % 6];
    return 0;
}

int top_df_dp(double t, const double *y, double *df_dp, void *user_data)
{
    const double *p = user_data, *m = y + 9;
    const double a = -m[0] / (p[0] * p[0]), b = -m[1] / (p[1] * p[1]), c = -m[2] / (p[2] * p[2]);
    const double rows[6][4] = {
        {a, 0, 0, 0},
        {0, b, 0, 0},
        {0, 0, c, 0},
        {0, -m[2] * b, m[1] * c, y[7]},
        {m[2] * a, 0, -m[0] * c, -y[6]},
        {-m[1] * a, m[0] * b, 0, 0},
    };
    for (int i = 0; i < 24; i++)
        df_dp[i] = rows[i / 4][i % 4];
    return 0;
}

double gust_level(double t, const double *y, void *user_data)
{
    const double *p = user_data;
    return y[9] - p[4];
}

// A scalar equation without parameters: the input is the slope.
int slope_is_input(double t, const double *y, double *f, void *user_data)
{
    f[0] = *(double *)user_data;
    return 0;
}

// It stops with code 3 at one half where the rate is large.
int limited(double t, const double *y, double *f, void *user_data)
{
    const double *rate = user_data;
    f[0] = rate[0];
    f[1] = y[0] - t;
    f[2] = rate[1] * y[4];
    return rate[0] > 100.0 && t > 0.5 ? 3 : 0;
}
