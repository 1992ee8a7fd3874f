/* A'X + X A - X G X + Q = 0 by doubling (Chu, Fan and Lin 2005) and Newton's method (Kleinman 1968). */

#define OFF_POLE 1.17 /* keeps the rate of the Cayley map from mirror images of closed-loop poles */

static void inverse_of(double *V, const double *S) /* by Gauss-Jordan elimination with row pivots */
{
    double W[2 * NN];
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) {
            W[i * 2 * N + j] = S[i * N + j];
            W[i * 2 * N + N + j] = i == j;
        }
    }
    for (int k = 0; k < N; ++k) {
        double row[2 * N];
        int pivot = k;
        for (int i = k + 1; i < N; ++i) {
            pivot = fabs(W[i * 2 * N + k]) > fabs(W[pivot * 2 * N + k]) ? i : pivot;
        }
        for (int j = k; j < 2 * N; ++j) {
            row[j] = W[pivot * 2 * N + j] / W[pivot * 2 * N + k];
        }
        memcpy(W + pivot * 2 * N + k, W + k * 2 * N + k, (size_t)(2 * N - k) * sizeof *W);
        memcpy(W + k * 2 * N + k, row + k, (size_t)(2 * N - k) * sizeof *W);
        for (int i = 0; i < N; ++i) {
            const double factor = W[i * 2 * N + k];
            for (int j = k; i != k && j < 2 * N; ++j) {
                W[i * 2 * N + j] -= factor * row[j];
            }
        }
    }
    for (int i = 0; i < N; ++i) {
        memcpy(V + i * N, W + i * 2 * N + N, N * sizeof *V);
    }
}

static void shifted_inverse(double *V, const double *A, double shift) /* V = (A - shift I)^-1 */
{
    double S[NN];
    memcpy(S, A, sizeof S);
    for (int i = 0; i < N; ++i) {
        S[i * N + i] -= shift;
    }
    inverse_of(V, S);
}

static int kleinman(const equation *e, const double *X, double *d, double *left)
{
    double closed[NN], R[NN], P[NN], V[NN];
    const double shift = e->shift;
    mul(P, e->G, X);
    for (int i = 0; i < NN; ++i) {
        closed[i] = e->A[i] - P[i];
    }
    transposed_mul(R, e->A, X);
    mul(P, X, closed);
    for (int i = 0; i < NN; ++i) {
        R[i] += P[i];
    }
    symmetrise(R);
    for (int i = 0; i < NN; ++i) {
        R[i] += e->Q[i];
    }
    const double before = size_of(R, NN);
    shifted_inverse(V, closed, shift);
    mul(P, R, V);
    transposed_mul(R, V, P);
    for (int i = 0; i < NN; ++i) {
        R[i] = 2 * shift * R[i];
        closed[i] = (i % (N + 1) == 0) + 2 * shift * V[i];
    }
    const int stable = stein(d, closed, R);
    mul(P, e->G, d);
    mul(R, d, P);
    *left = size_of(R, NN) / (before + TINY);
    return stable;
}

/* X and Z near the solutions of the equation and of its dual, A Z + Z A' - Z Q Z + G = 0, from nothing. */
static void neighbourhood(const equation *e, double *X, double *Z)
{
    double V[NN], F[NN], C[NN], Y[NN], VG[NN], VGY[NN], P[NN], A[NN];
    const double shift = OFF_POLE * e->shift;
    shifted_inverse(V, e->A, shift);
    cholesky(C, e->Q);
    mul(F, C, V);
    transposed_mul(P, F, F);
    half_kernel(Y, e->G, P);
    mul(VG, V, e->G);
    mul_transposed(P, e->G, Y);
    mul(VGY, V, P);
    mul(P, VGY, Y);
    for (int i = 0; i < NN; ++i) {
        A[i] = (i % (N + 1) == 0) + 2 * shift * (V[i] - P[i]);
    }
    mul_transposed(P, VG, V);
    mul_transposed(F, VGY, VGY);
    transposed_mul(X, Y, Y);
    for (int i = 0; i < NN; ++i) {
        Z[i] = 2 * shift * (P[i] - F[i]);
        X[i] = 2 * shift * X[i];
    }
    doubled(A, Z, X);
}
