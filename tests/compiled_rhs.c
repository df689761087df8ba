// Right-hand sides for tests of the compiled integrator.
#include <math.h>
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

int growth(double t, const double *y, double *f, void *user_data)
{
    (void)t, (void)user_data;
    f[0] = y[0];
    return 0;
}

int square(double t, const double *y, double *f, void *user_data)
{
    (void)t, (void)user_data;
    f[0] = y[0] * y[0];
    return 0;
}

// It stops the integration with code 7 where time or the point has passed one half.
int stops(double t, const double *y, double *f, void *user_data)
{
    (void)user_data;
    f[0] = 0.0;
    return t > 0.5 || y[0] > 0.5 ? 7 : 0;
}

int turns_nan(double t, const double *y, double *f, void *user_data)
{
    (void)y, (void)user_data;
    f[0] = t > 0.5 ? NAN : 1.0;
    return 0;
}

int writes_nothing(double t, const double *y, double *f, void *user_data)
{
    (void)t, (void)y, (void)f, (void)user_data;
    return 0;
}

// At time zero it waits until two callers are there, for at most data[1] milliseconds.
int meets(double t, const double *y, double *f, void *user_data)
{
    struct { atomic_int callers; int patience; } *data = user_data;
    (void)y;
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

int rests(double t, const double *y, double *f, void *user_data)
{
    (void)t, (void)y, (void)user_data;
    f[0] = 0.0;
    return 0;
}

// On SO(3), a hundred times as fast after t = 5
int jump(double t, const double *y, double *f, void *user_data)
{
    double rate = 1.0 + 99.0 / (1.0 + exp(-50.0 * (t - 5.0)));
    (void)user_data;
    f[0] = rate;
    f[1] = 0.2 * rate;
    f[2] = y[1] * rate;
    return 0;
}

// As many zeros as the data say
int rests_all(double t, const double *y, double *f, void *user_data)
{
    const double *count = user_data;
    (void)t, (void)y;
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
    (void)t, (void)user_data;
    f[0] = -y[0];
    ((double *)y)[0] = 17.0;
    return 0;
}

// f_i = rate cos(t + i) + weight y[(5 i + 1) mod n]; the data are rate, weight, dim, n
int driven(double t, const double *y, double *f, void *user_data)
{
    const double *data = user_data;
    int dim = (int)data[2], n = (int)data[3];
    for (int i = 0; i < dim; i++)
        f[i] = data[0] * cos(t + i) + data[1] * y[(5 * i + 1) % n];
    return 0;
}
