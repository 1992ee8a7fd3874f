/*
 * minimise v'P v/2 + f'v  subject to  lower <= v <= upper,  A v <= b,      f, b affine in the measured data
 *
 * The dual active-set method of Goldfarb and Idnani (1983), Mathematical Programming 27, 1: from the optimum on some
 * rows, the row that is violated most is driven to its limit while the multipliers stay positive; one that vanishes on
 * the way lets its row go. Every step increases the optimum, so that no set of rows comes twice. It starts from the
 * rows that were active at the last sample, as Arnstrom, Bemporad and Axehill (2022), IEEE TAC 67, 4362, do.
 *
 * J'P J = I and J'N = [R; 0] for the rows N of the working set: J1, its first columns, and J2, the others, give what
 * limits and gradients do to v. J starts from `root` and is turned by reflections and rotations alone.
 */
#define COUNT (MPC_VARIABLES + MPC_ROWS)
#define DEPENDENT 1e-20 /* square of what a row has beyond the span of others, relative: less is nothing */
#define NOISE 1e-14     /* of a row's sum, relative to its terms: a smaller excess is none */
#define DISTINCT 9e-12  /* the same, of a row whose excess is weighed by the check */
#define ROUNDING 1e-15  /* of a gradient, relative to its terms */
#define ACCURACY 1e-8   /* bound of the error that passes the check, in units of each command's larger limit */
#define ROUGH 1e-4      /* of a command that leaves all the same, and is told */

/* d = J'a of a row with the sign of its limit: + for the upper, - for the lower. */
static void seen(const mpc_state *s, int row, double sign, double d[MPC_VARIABLES])
{
    for (int j = 0; j < MPC_VARIABLES; ++j) {
        d[j] = 0;
    }
    if (row < MPC_VARIABLES) {
        for (int j = 0; j < MPC_VARIABLES; ++j) {
            d[j] = sign * s->J[row][j];
        }
        return;
    }
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        const double a = sign * A[row - MPC_VARIABLES][i];
        for (int j = 0; a != 0 && j < MPC_VARIABLES; ++j) {
            d[j] += a * s->J[i][j];
        }
    }
}

static double limit(const mpc_state *s, int row, double sign)
{
    return row >= MPC_VARIABLES ? s->b[row - MPC_VARIABLES] : sign > 0 ? upper[row] : -lower[row];
}

static double along(const mpc_state *s, int row, double sign)
{
    double sum = 0;
    if (row < MPC_VARIABLES) {
        return sign * s->v[row];
    }
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        sum += A[row - MPC_VARIABLES][i] * s->v[i];
    }
    return sum;
}

/* Sum of squares of d from its entry k on. */
static double squares(const double d[MPC_VARIABLES], int k)
{
    double sum = 0;
    for (int j = k; j < MPC_VARIABLES; ++j) {
        sum += d[j] * d[j];
    }
    return sum;
}

/* x becomes R^-1 x. */
static void back(const mpc_state *s, double x[MPC_VARIABLES])
{
    for (int i = s->size - 1; i >= 0; --i) {
        for (int j = i + 1; j < s->size; ++j) {
            x[i] -= s->R[i][j] * x[j];
        }
        x[i] /= s->R[i][i];
    }
}

/* x becomes R'^-1 x. */
static void forth(const mpc_state *s, double x[MPC_VARIABLES])
{
    for (int i = 0; i < s->size && i < MPC_VARIABLES; ++i) {
        for (int j = 0; j < i; ++j) {
            x[i] -= s->R[j][i] * x[j];
        }
        x[i] /= s->R[i][i];
    }
}

/* A row with d = J'a joins the working set: a reflection turns d to [d1, R_kk, 0]. */
static void join(mpc_state *s, int row, double sign, double multiplier, double d[MPC_VARIABLES])
{
    const int k = s->size;
    const double square = squares(d, k), corner = d[k] > 0 ? -sqrt(square) : sqrt(square);
    const double scale = 1 / (square - corner * d[k]);

    for (int i = 0; i < k; ++i) {
        s->R[i][k] = d[i];
    }
    s->R[k][k] = corner;
    d[k] -= corner;
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        double sum = 0;
        for (int j = k; j < MPC_VARIABLES; ++j) {
            sum += s->J[i][j] * d[j];
        }
        for (int j = k; j < MPC_VARIABLES; ++j) {
            s->J[i][j] -= scale * sum * d[j];
        }
    }
    s->row[k] = row;
    s->sign[k] = sign;
    s->y[k] = multiplier;
    s->taken[row] = 1;
    s->size = k + 1;
}

/* The k-th row leaves the working set: rotations make R triangular again. */
static void leave(mpc_state *s, int k)
{
    s->taken[s->row[k]] = 0;
    s->size -= 1;
    for (int j = k; j < s->size; ++j) {
        s->row[j] = s->row[j + 1];
        s->sign[j] = s->sign[j + 1];
        s->y[j] = s->y[j + 1];
        for (int i = 0; i <= j + 1; ++i) {
            s->R[i][j] = s->R[i][j + 1];
        }
    }
    for (int j = k; j < s->size; ++j) {
        const double a = s->R[j][j], b = s->R[j + 1][j], length = hypot(a, b), c = a / length, t = b / length;
        for (int i = j; i < s->size; ++i) {
            const double first = s->R[j][i], second = s->R[j + 1][i];
            s->R[j][i] = c * first + t * second;
            s->R[j + 1][i] = c * second - t * first;
        }
        for (int i = 0; i < MPC_VARIABLES; ++i) {
            const double first = s->J[i][j], second = s->J[i][j + 1];
            s->J[i][j] = c * first + t * second;
            s->J[i][j + 1] = c * second - t * first;
        }
    }
}
