// A plain loop over equal steps of an explicit method, for rotations and three numbers: the flows of
// a path make one quaternion that turns the point once, as in the package, and one step of Newton
// and Schulz removes rounding from each result. There is nothing else: no step control, no output,
// no checks. The field is a pointer to a function of another library, which isn't inlined.
#include <math.h>
#include <string.h>

enum { MAX_STAGES = 32, MAX_TERMS = 512, MAX_PATHS = 64, MAX_SIZE = 12 };

typedef int field(double t, const double *y, double *f, void *user_data);

static inline void times(const double *p, const double *q, double *pq)
{
    pq[0] = p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1];
    pq[1] = p[3] * q[1] + p[1] * q[3] + p[2] * q[0] - p[0] * q[2];
    pq[2] = p[3] * q[2] + p[2] * q[3] + p[0] * q[1] - p[1] * q[0];
    pq[3] = p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2];
}

// The unit quaternion (vector part, scalar part) that turns by v
static inline void exponential(const double *v, double *e)
{
    const double half = fmax(sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / 2, 1e-150);
    const double scale = sin(half) / half / 2;
    for (int i = 0; i < 3; i++)
        e[i] = scale * v[i];
    e[3] = cos(half);
}

// y <- y q, of a quaternion or of a matrix, row by row
static inline void turn(int entries, const double *q, double *y)
{
    if (entries == 4) {
        double turned[4];
        times(y, q, turned);
        memcpy(y, turned, sizeof turned);
        return;
    }
    const double a = 2 * q[0], b = 2 * q[1], c = 2 * q[2];
    const double r[9] = {
        1 - (b * q[1] + c * q[2]), a * q[1] - c * q[3],       c * q[0] + b * q[3],
        a * q[1] + c * q[3],       1 - (a * q[0] + c * q[2]), b * q[2] - a * q[3],
        c * q[0] - b * q[3],       b * q[2] + a * q[3],       1 - (a * q[0] + b * q[1]),
    };
    for (int i = 0; i < 9; i += 3) {
        const double x0 = y[i], x1 = y[i + 1], x2 = y[i + 2];
        for (int j = 0; j < 3; j++)
            y[i + j] = x0 * r[j] + x1 * r[3 + j] + x2 * r[6 + j];
    }
}

static inline double dot(int n, const double *x, const double *y)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += x[i] * y[i];
    return sum;
}

static inline void restore(int entries, double *y)
{
    if (entries == 4) {
        const double scale = 1.5 - 0.5 * dot(4, y, y);
        for (int i = 0; i < 4; i++)
            y[i] *= scale;
        return;
    }
    const double *x = y, xx = 1.5 - 0.5 * dot(3, x, x), yy = 1.5 - 0.5 * dot(3, x + 3, x + 3),
                 zz = 1.5 - 0.5 * dot(3, x + 6, x + 6), xy = -0.5 * dot(3, x, x + 3),
                 yz = -0.5 * dot(3, x + 3, x + 6), zx = -0.5 * dot(3, x + 6, x);
    for (int i = 0; i < 3; i++) {
        const double a = y[i], b = y[3 + i], c = y[6 + i];
        y[i] = xx * a + xy * b + zx * c;
        y[3 + i] = xy * a + yy * b + yz * c;
        y[6 + i] = zx * a + yz * b + zz * c;
    }
}

__attribute__((always_inline)) static inline int
run(int entries, field *f, void *data, const int *list, const double *weights, const double *c,
    double h, int steps, int members, const double *start, double *end)
{
    const int paths = list[0], flows = list[1], terms = list[2], stages = list[3];
    const int *origin = list + 4, *first_flow = origin + paths, *first_term = first_flow + paths + 1,
              *stage = first_term + flows + 1, *stage_path = stage + terms,
              result = stage_path[stages], size = entries + 3;
    double weight[MAX_TERMS], y[MAX_PATHS + 1][MAX_SIZE], k[MAX_STAGES][6];
    for (int i = 0; i < terms; i++)
        weight[i] = h * weights[i];
    for (int member = 0; member < members; member++, start += size, end += size) {
        memcpy(y[0], start, size * sizeof *start);
        for (int step = 0; step < steps; step++) {
            int followed = 0;
            for (int i = 0; i <= stages; i++) {
                const int wanted = i < stages ? stage_path[i] : result;
                while (followed < wanted) {
                    double *point = y[followed + 1], q[4] = {0}, e[4], product[4];
                    memcpy(point, y[origin[followed]], size * sizeof *point);
                    for (int j = first_flow[followed]; j < first_flow[followed + 1]; j++) {
                        double v[3] = {0, 0, 0};
                        for (int n = first_term[j - 1] - 1; n < first_term[j] - 1; n++)
                            for (int l = 0; l < 3; l++) {
                                v[l] += weight[n] * k[stage[n] - 1][l];
                                point[entries + l] += weight[n] * k[stage[n] - 1][3 + l];
                            }
                        if (j == first_flow[followed]) {
                            exponential(v, q);
                        } else {
                            exponential(v, e);
                            times(q, e, product);
                            memcpy(q, product, sizeof q);
                        }
                    }
                    turn(entries, q, point);
                    followed++;
                }
                if (i < stages && f((step + c[i]) * h, y[wanted], k[i], data))
                    return 1;
            }
            restore(entries, y[result]);
            memcpy(y[0], y[result], sizeof y[0]);
        }
        memcpy(end, y[0], size * sizeof *end);
    }
    return 0;
}

// entries: 9 of matrices, 4 of quaternions (scalar last); list: integers of METHOD in
// cg/support/shared_numbers.py, then the path to the result; start, end: members x (entries + 3)
int integrate(int entries, field *f, void *data, const int *list, const double *weights,
              const double *c, double h, int steps, int members, const double *start, double *end)
{
    if (entries == 4)
        return run(4, f, data, list, weights, c, h, steps, members, start, end);
    return run(9, f, data, list, weights, c, h, steps, members, start, end);
}
