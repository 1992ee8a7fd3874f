/* The gain of the model sampled at y with u held (Van Loan), X = Q + F'X (I + G X)^-1 F by doubling and Newton. */

#define ALL (N + M)
#define BIG (2 * ALL)
#define LARGEST 5.371920351148152 /* 1-norm up to which Pade [13/13] is exact to rounding (Higham 2005) */
#define SQUARINGS 16

static double norm1(const double *A, int n) /* largest sum of a column */
{
    double largest = 0;
    for (int j = 0; j < n; ++j) {
        double sum = 0;
        for (int i = 0; i < n; ++i) {
            sum += fabs(A[i * n + j]);
        }
        largest = sum <= largest ? largest : sum;
    }
    return largest;
}

static double largest(const double *A, int count)
{
    double most = 0;
    for (int i = 0; i < count; ++i) {
        most = fabs(A[i]) > most ? fabs(A[i]) : most;
    }
    return most;
}

/* The power of two next to x, 1 where there is none: units changed by it change no bits. */
static double binary(double x)
{
    double power = 1;
    while (isfinite(x) && power < 0.7 * x) {
        power *= 2;
    }
    while (x > 0 && power > 1.5 * x) {
        power /= 2;
    }
    return power;
}

/* A (BIG, BIG) becomes e^A by Pade [13/13] and squaring; returns 0 where it is too large for that. */
static int exponential(double *A)
{
    static const double b[14] = {
        64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0, 129060195264000.0,
        10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0, 40840800.0, 960960.0, 16380.0, 182.0, 1.0,
    };
    double A2[BIG * BIG], A4[BIG * BIG], A6[BIG * BIG], U[BIG * BIG], V[BIG * BIG];
    int squarings = 0;
    const double norm = norm1(A, BIG) / LARGEST;
    double scale = 1;
    if (!isfinite(norm)) {
        return 0;
    }
    for (; norm / scale >= 2; scale *= 2) {
        if (++squarings > SQUARINGS) {
            return 0;
        }
    }
    for (int i = 0; i < BIG * BIG; ++i) {
        A[i] /= scale;
    }
    product(A2, A, A, BIG, BIG, BIG);
    product(A4, A2, A2, BIG, BIG, BIG);
    product(A6, A4, A2, BIG, BIG, BIG);
    for (int i = 0; i < BIG * BIG; ++i) {
        V[i] = b[13] * A6[i] + b[11] * A4[i] + b[9] * A2[i];
    }
    product(U, A6, V, BIG, BIG, BIG);
    for (int i = 0; i < BIG * BIG; ++i) {
        V[i] = U[i] + b[7] * A6[i] + b[5] * A4[i] + b[3] * A2[i] + b[1] * (i % (BIG + 1) == 0);
    }
    product(U, A, V, BIG, BIG, BIG);
    for (int i = 0; i < BIG * BIG; ++i) {
        A[i] = b[12] * A6[i] + b[10] * A4[i] + b[8] * A2[i];
    }
    product(V, A6, A, BIG, BIG, BIG);
    for (int i = 0; i < BIG * BIG; ++i) {
        V[i] = V[i] + b[6] * A6[i] + b[4] * A4[i] + b[2] * A2[i] + b[0] * (i % (BIG + 1) == 0);
        A[i] = U[i] + V[i];
        V[i] -= U[i];
    }
    solve(V, A, BIG, BIG);
    for (; squarings > 0; --squarings) {
        product(U, A, A, BIG, BIG, BIG);
        memcpy(A, U, sizeof U);
    }
    return 1;
}

/* Closed loop (I + G X)^-1 A and residual of the discrete equation. */
static void residual_at(const equation *e, const double *X, double *closed, double *R)
{
    double Y[NN], YA[NN], GY[NN];
    half_kernel(Y, e->G, X);
    mul(YA, Y, e->A);
    mul_transposed(GY, e->G, Y);
    mul(closed, GY, YA);
    transposed_mul(R, YA, YA);
    for (int i = 0; i < NN; ++i) {
        closed[i] = e->A[i] - closed[i];
        R[i] = e->Q[i] - X[i] + R[i];
    }
    symmetrise(R);
}

static int hewer(const equation *e, const double *X, double *d, double *left)
{
    double closed[NN], R[NN], after[NN];
    residual_at(e, X, closed, R);
    const double before = size_of(R, NN);
    const int stable = stein(d, closed, R);
    for (int i = 0; i < NN; ++i) {
        after[i] = X[i] + d[i];
    }
    residual_at(e, after, closed, R);
    *left = size_of(R, NN) / (before + TINY);
    return stable;
}

static int gain_at(memory *state, const double *A_given, const double *B_given, double *K)
{
    double E[BIG * BIG] = { 0 }, end[ALL * ALL], T[ALL * ALL], J[ALL * ALL];
    double F[NN], G[N * M], GT[M * N], cross_weight[N * M], weight[M * M], S[M * 2 * N], RN[M * N], RG[M * N];
    double P[NN], H[NN], X[NN], A0[NN], G0[NN], Q0[NN];
    double A[NN], B[N * M], Q[NN], unit[N]; /* units of x in which all states are weighed alike */
    (void)state;
    for (int i = 0; i < N; ++i) {
        unit[i] = 1 / binary(sqrt(weight_Q[i * (N + 1)]));
    }
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) {
            A[i * N + j] = A_given[i * N + j] * unit[j] / unit[i];
            Q[i * N + j] = unit[i] * weight_Q[i * N + j] * unit[j];
        }
        for (int j = 0; j < M; ++j) {
            B[i * M + j] = B_given[i * M + j] / unit[i];
        }
    }
    const double longest = largest(A, NN) * dt > 1 ? largest(A, NN) * dt : 1;
    const double b = 1 / binary(largest(B, N * M) * dt / longest); /* unit of u */
    const double costs = largest(Q, NN), commands = b * b * largest(weight_R, M * M);
    const double w = binary((costs > commands ? costs : commands) * dt / longest); /* unit of the cost */
    for (int i = 0; i < N; ++i) { /* [[-M', W], [0, M]] dt with M = [[A, B], [0, 0]] and W = [[Q, 0], [0, R]] */
        for (int j = 0; j < N; ++j) {
            E[j * BIG + i] = -A[i * N + j] * dt;
            E[(ALL + i) * BIG + ALL + j] = A[i * N + j] * dt;
            E[i * BIG + ALL + j] = Q[i * N + j] / w * dt;
        }
        for (int j = 0; j < M; ++j) {
            E[(N + j) * BIG + i] = -(b * B[i * M + j]) * dt;
            E[(ALL + i) * BIG + ALL + N + j] = b * B[i * M + j] * dt;
        }
    }
    for (int i = 0; i < M; ++i) {
        for (int j = 0; j < M; ++j) {
            E[(N + i) * BIG + ALL + N + j] = b * b * weight_R[i * M + j] / w * dt;
        }
    }
    if (!exponential(E)) {
        return 0;
    }
    for (int i = 0; i < ALL; ++i) {
        for (int j = 0; j < ALL; ++j) {
            end[i * ALL + j] = E[(ALL + i) * BIG + ALL + j];
            J[i * ALL + j] = E[i * BIG + ALL + j];
        }
    }
    transposed(T, end, ALL, ALL);
    product(end, T, J, ALL, ALL, ALL); /* the integral of the cost; T' has the model */
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) {
            F[i * N + j] = T[j * ALL + i];
            Q0[i * N + j] = w * end[i * ALL + j];
        }
        for (int j = 0; j < M; ++j) {
            G[i * M + j] = T[(N + j) * ALL + i] / b;
            cross_weight[i * M + j] = w * end[i * ALL + N + j] / b;
            S[j * 2 * N + i] = cross_weight[i * M + j];
            S[j * 2 * N + N + i] = G[i * M + j];
        }
    }
    for (int i = 0; i < M; ++i) {
        for (int j = 0; j < M; ++j) {
            weight[i * M + j] = J[i * M + j] = w * end[(N + i) * ALL + N + j] / (b * b);
        }
    }
    solve(J, S, M, 2 * N); /* takes the cross weight out */
    for (int i = 0; i < M; ++i) {
        memcpy(RN + i * N, S + i * 2 * N, N * sizeof *RN);
        memcpy(RG + i * N, S + i * 2 * N + N, N * sizeof *RG);
    }
    product(P, G, RN, N, M, N);
    product(G0, G, RG, N, M, N);
    product(H, cross_weight, RN, N, M, N);
    for (int i = 0; i < NN; ++i) {
        A0[i] = F[i] - P[i];
        Q0[i] -= H[i];
        X[i] = Q0[i];
        H[i] = G0[i];
        P[i] = A0[i];
    }
    const equation e = { hewer, A0, G0, Q0, 0 };
    doubled(P, H, X);
    const int ok = newton(&e, X, NEWTON_STEPS);
    transposed(GT, G, N, M);
    product(RN, GT, X, M, N, N);
    product(K, RN, F, M, N, N);
    product(J, RN, G, M, N, M);
    for (int i = 0; i < M; ++i) {
        for (int j = 0; j < N; ++j) {
            K[i * N + j] += cross_weight[j * M + i];
        }
    }
    for (int i = 0; i < M * M; ++i) {
        weight[i] += J[i];
    }
    solve(weight, K, M, N);
    for (int i = 0; i < M * N; ++i) {
        K[i] /= unit[i % N];
    }
    return ok && finite(K, M * N);
}
