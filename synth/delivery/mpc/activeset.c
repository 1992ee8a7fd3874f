/* g = P v + f, and A'y with the multipliers of the rows; with those of the variables too if they are asked for. */
static void gradient(const mpc_state *s, int all, double g[MPC_VARIABLES])
{
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        g[i] = s->f[i];
        for (int j = 0; j < MPC_VARIABLES; ++j) {
            g[i] += P[i][j] * s->v[j];
        }
    }
    for (int k = 0; k < s->size; ++k) {
        if (s->row[k] >= MPC_VARIABLES) {
            for (int j = 0; j < MPC_VARIABLES; ++j) {
                g[j] += A[s->row[k] - MPC_VARIABLES][j] * s->y[k];
            }
        } else if (all) {
            g[s->row[k]] += s->sign[k] * s->y[k];
        }
    }
}

/* v and y with the rows of the working set at their limits: from nothing, then from what is left over. */
static void optimum(mpc_state *s, int passes)
{
    double g[MPC_VARIABLES], c[MPC_VARIABLES], y[MPC_VARIABLES];

    for (int i = 0; i < MPC_VARIABLES; ++i) {
        s->v[i] = s->y[i] = 0;
    }
    for (int pass = 0; pass < passes; ++pass) {
        gradient(s, 1, g);
        memset(c, 0, sizeof c);
        for (int i = 0; i < MPC_VARIABLES; ++i) {
            for (int j = 0; j < MPC_VARIABLES; ++j) {
                c[j] -= s->J[i][j] * g[i];
            }
        }
        memcpy(y, c, sizeof y);
        for (int k = 0; k < s->size; ++k) {
            c[k] = limit(s, s->row[k], s->sign[k]) - along(s, s->row[k], s->sign[k]);
        }
        forth(s, c);
        for (int k = 0; k < s->size; ++k) {
            y[k] -= c[k];
        }
        back(s, y);
        for (int i = 0; i < MPC_VARIABLES; ++i) {
            for (int j = 0; j < MPC_VARIABLES; ++j) {
                s->v[i] += s->J[i][j] * c[j];
            }
        }
        for (int k = 0; k < s->size; ++k) {
            s->y[k] += y[k];
            if (s->row[k] < MPC_VARIABLES) {
                s->v[s->row[k]] = s->sign[k] * limit(s, s->row[k], s->sign[k]);
            }
        }
    }
}

/* How far rounding can put the sum of a row off. */
static double unsure(const mpc_state *s, int row)
{
    double size = 1;
    if (row < MPC_VARIABLES) {
        return NOISE * (size + fabs(s->v[row]));
    }
    for (int j = 0; j < MPC_VARIABLES; ++j) {
        size += fabs(A[row - MPC_VARIABLES][j] * s->v[j]);
    }
    return NOISE * (size + fabs(s->b[row - MPC_VARIABLES]));
}

/* The row that is violated most, by more than rounding, relative to its length in the metric of P; -1 for none. */
static int violated(mpc_state *s, double *sign)
{
    int worst = -1;
    double most = 0;

    for (int i = 0; i < COUNT; ++i) {
        double side = 1, excess;
        if (i < MPC_VARIABLES) {
            side = upper[i] - s->v[i] < s->v[i] - lower[i] ? 1 : -1;
            excess = side > 0 ? s->v[i] - upper[i] : lower[i] - s->v[i];
        } else {
            s->w[i - MPC_VARIABLES] = along(s, i, 1);
            excess = s->w[i - MPC_VARIABLES] - s->b[i - MPC_VARIABLES];
        }
        if (!s->taken[i] && excess > most * length[i] && excess > unsure(s, i)) {
            most = excess / length[i];
            worst = i;
            *sign = side;
        }
    }
    return worst;
}

/* Drives a violated row to its limit; 0 if that takes too many exchanges. */
static int enter(mpc_state *s, int row, double sign)
{
    double multiplier = 0, d[MPC_VARIABLES], r[MPC_VARIABLES];

    while (s->iterations < s->allowed) {
        double square, whole, full = INFINITY, part = INFINITY, step;
        int leaving = -1;

        s->iterations += 1;
        seen(s, row, sign, d);
        square = squares(d, s->size);
        whole = squares(d, 0);
        for (int k = 0; k < s->size; ++k) {
            r[k] = d[k];
        }
        back(s, r);
        for (int k = 0; k < s->size; ++k) {
            if (r[k] > 0 && s->y[k] < part * r[k]) {
                part = s->y[k] / r[k];
                leaving = k;
            }
        }
        if (s->size < MPC_VARIABLES && square > DEPENDENT * whole) {
            full = (along(s, row, sign) - limit(s, row, sign)) / square;
        }
        step = full < part ? full : part;
        if (!(step < INFINITY)) {
            s->taken[row] = 1; /* it lies in the span of the others: violated by rounding, or the check will tell */
            return 1;
        }
        for (int i = 0; full < INFINITY && i < MPC_VARIABLES; ++i) {
            for (int j = s->size; j < MPC_VARIABLES; ++j) {
                s->v[i] -= step * s->J[i][j] * d[j];
            }
        }
        for (int k = 0; k < s->size; ++k) {
            s->y[k] -= step * r[k];
            s->y[k] = s->y[k] > 0 ? s->y[k] : 0;
        }
        multiplier += step;
        if (full <= part) {
            join(s, row, sign, multiplier, d);
            return 1;
        }
        leave(s, leaving);
    }
    return 0;
}

/* How far rounding can put the gradient off. */
static void blur(const mpc_state *s, double noise[MPC_VARIABLES])
{
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        noise[i] = fabs(s->f[i]);
        for (int j = 0; j < MPC_VARIABLES; ++j) {
            noise[i] += fabs(P[i][j] * s->v[j]);
        }
    }
    for (int k = 0; k < s->size; ++k) {
        for (int j = 0; s->row[k] >= MPC_VARIABLES && j < MPC_VARIABLES; ++j) {
            noise[j] += fabs(A[s->row[k] - MPC_VARIABLES][j] * s->y[k]);
        }
        if (s->row[k] < MPC_VARIABLES) {
            noise[s->row[k]] += s->y[k];
        }
    }
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        noise[i] *= ROUNDING;
    }
}

/* Rows leave the working set whose multipliers are not positive beyond what rounding does to them. */
static void let_doubtful_go(mpc_state *s)
{
    double noise[MPC_VARIABLES], doubt[MPC_VARIABLES], x[MPC_VARIABLES];

    blur(s, noise);
    for (int k = 0; k < s->size; ++k) {
        doubt[k] = 0;
    }
    for (int i = 0; i < MPC_VARIABLES + s->size; ++i) { /* of the gradient, then of the rows */
        const int j = i - MPC_VARIABLES;
        const double size = j < 0 ? noise[i] : s->row[j] < MPC_VARIABLES ? 0 : unsure(s, s->row[j]);
        if (!(size > 0)) {
            continue;
        }
        for (int k = 0; k < s->size; ++k) {
            x[k] = j < 0 ? s->J[i][k] : k == j;
        }
        if (j >= 0) {
            forth(s, x);
        }
        back(s, x);
        for (int k = 0; k < s->size; ++k) {
            doubt[k] += fabs(x[k]) * size;
        }
    }
    for (int k = s->size - 1; k >= 0; --k) {
        if (!(s->y[k] > doubt[k])) {
            leave(s, k);
        }
    }
}

/* From the working set to the optimum; 0 if that takes too many exchanges. */
static int search(mpc_state *s)
{
    int row;
    double sign = 1;

    for (;;) { /* rows of the last sample whose multipliers are negative now are let go */
        int least = 0;
        optimum(s, 1);
        for (int k = 1; k < s->size; ++k) {
            least = s->y[k] < s->y[least] ? k : least;
        }
        if (s->size == 0 || !(s->y[least] < 0)) {
            break;
        }
        if (s->iterations >= s->allowed) {
            return 0;
        }
        s->iterations += 1;
        leave(s, least);
    }
    for (;;) {
        for (row = violated(s, &sign); row >= 0; row = violated(s, &sign)) {
            if (!enter(s, row, sign)) {
                return 0;
            }
        }
        optimum(s, 3);
        if (violated(s, &sign) < 0) {
            let_doubtful_go(s);
            return 1;
        }
    }
}

/* Largest entry of the commands, in magnitude, of J2 J2'a (of a row with d = J'a). */
static double moved(const mpc_state *s, const double d[MPC_VARIABLES])
{
    double most = 0;
    for (int i = 0; i < MPC_OUTPUTS; ++i) {
        double sum = 0;
        for (int j = s->size; j < MPC_VARIABLES; ++j) {
            sum += s->J[i][j] * d[j];
        }
        most = fabs(sum) > most ? fabs(sum) : most;
    }
    return most;
}

/*
 * How far the commands can be from the optimum, each in its own unit: the natural residual
 * e = [v; A v] - clip([v - g; A v + y]), g = P v + f + A'y (stationary, within the limits, multipliers of the right
 * sign, complementary), times what each of its entries does to the commands as long as the same rows are active.
 */
static double error_bound(const mpc_state *s)
{
    double g[MPC_VARIABLES], noise[MPC_VARIABLES], d[MPC_VARIABLES], effect[MPC_VARIABLES], e[COUNT];
    double sum = 0, reach = 0;

    gradient(s, 0, g);
    blur(s, noise);
    for (int i = 0; i < MPC_VARIABLES; ++i) {
        const double z = s->v[i] - g[i];
        e[i] = fabs(s->v[i] - (z > upper[i] ? upper[i] : z < lower[i] ? lower[i] : z));
    }
    for (int i = 0; i < MPC_ROWS; ++i) {
        e[MPC_VARIABLES + i] = s->w[i] > s->b[i] ? s->w[i] - s->b[i] : 0;
    }
    for (int k = 0; k < s->size; ++k) {
        if (s->row[k] >= MPC_VARIABLES) {
            const int i = s->row[k] - MPC_VARIABLES;
            const double z = s->w[i] + s->y[k];
            e[s->row[k]] = fabs(s->w[i] - (z > s->b[i] ? s->b[i] : z));
        }
    }
    for (int k = 0; k < s->size; ++k) {
        effect[k] = 0;
    }
    for (int i = 0; i < MPC_OUTPUTS; ++i) {
        reach = length[i] > reach ? length[i] : reach;
        for (int k = 0; k < s->size; ++k) {
            d[k] = s->J[i][k];
        }
        back(s, d);
        for (int k = 0; k < s->size; ++k) {
            effect[k] = fabs(d[k]) > effect[k] ? fabs(d[k]) : effect[k];
        }
    }
    for (int k = 0; k < s->size; ++k) {
        sum += effect[k] * e[s->row[k]];
        e[s->row[k]] = 0;
    }
    for (int i = 0; i < COUNT; ++i) {
        if (i < MPC_VARIABLES) {
            e[i] += s->taken[i] ? 0 : noise[i];
        } else if (e[i] != 0) {
            const double rounding = unsure(s, i);
            e[i] = e[i] <= rounding ? 0 : e[i] - rounding;
        }
        if (e[i] != 0) {
            double square = 1;
            seen(s, i, 1, d);
            if (i >= MPC_VARIABLES) {
                const double least = DISTINCT * squares(d, 0);
                square = squares(d, s->size);
                if (!(square > least)) { /* in the span of the active ones, and yet it is violated */
                    sum += reach * e[i] / sqrt(least);
                    continue;
                }
            }
            sum += moved(s, d) * e[i] / square;
        }
    }
    return sum;
}

/* What is known of v as the optimum for f and b: from the last working set, and if that fails from none. */
static int solved(mpc_state *s)
{
    double d[MPC_VARIABLES];
    int rows = s->size > 0 && s->size <= MPC_VARIABLES ? s->size : 0;

    s->iterations = 0;
    s->allowed = rows == 0 ? MPC_ITERATIONS : MPC_ITERATIONS / 2;
    for (;;) {
        memcpy(s->J, root, sizeof s->J);
        memset(s->taken, 0, sizeof s->taken);
        s->size = 0;
        for (int k = 0; k < rows; ++k) {
            if (s->row[k] < 0 || s->row[k] >= COUNT || s->taken[s->row[k]]) {
                continue; /* no state of ours */
            }
            seen(s, s->row[k], s->sign[k], d);
            if (squares(d, s->size) > DEPENDENT * squares(d, 0)) {
                join(s, s->row[k], s->sign[k], 0, d);
            }
        }
        if (search(s)) {
            s->error = error_bound(s);
            if (s->error <= ACCURACY) {
                return MPC_SOLVED;
            }
            if (rows == 0 && s->error <= ROUGH) {
                return MPC_ROUGH;
            }
        }
        s->size = 0;
        if (rows == 0) {
            return MPC_UNSOLVED;
        }
        rows = 0;
        s->allowed = MPC_ITERATIONS;
    }
}
