/* What both Riccati equations need: half kernels, doubling, the Stein equation, Newton's method. All are (N, N). */

#define DOUBLINGS 40     /* 2^40 samples: slower convergence is a mode on the stability boundary */
#define NEAR 1e-3        /* size of the doubled closed loop where Newton takes over */
#define VANISHED 1e-4    /* size of the squared closed loop that counts as zero in a Newton step */
#define NEWTON_STEPS 8
#define ACCURACY 1e-11   /* relative error of a solution, as estimated from the last step */
#define RIDGE 1e-13      /* relative, keeps Cholesky factors of semidefinite matrices real */
#define DIVERGED 1e100   /* size of a square beyond which it has diverged */
#define NN (N * N)

/* The next Newton step d from X; what is left of the residual, relative; whether the closed loop is stable. */
typedef struct equation equation;
typedef int stepping(const equation *e, const double *X, double *d, double *left);
struct equation {
    stepping *step;
    const double *A, *G, *Q;
    double shift;
};

static void mul(double *C, const double *A, const double *B)
{
    product(C, A, B, N, N, N);
}

static void mul_transposed(double *C, const double *A, const double *B) /* C = A B' */
{
    double T[NN];
    transposed(T, B, N, N);
    mul(C, A, T);
}

static void transposed_mul(double *C, const double *A, const double *B) /* C = A'B */
{
    double T[NN];
    transposed(T, A, N, N);
    mul(C, T, B);
}

static void symmetrise(double *S)
{
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < i; ++j) {
            S[i * N + j] = S[j * N + i] = (S[i * N + j] + S[j * N + i]) / 2;
        }
    }
}

/* W = [S, F] becomes [L', L^-1 F] with S = L L' positive definite, its pivots not below `least`. */
static void eliminate(double *W, int columns, const double *least)
{
    for (int k = 0; k < N; ++k) {
        double *row = W + k * columns;
        const double root = sqrt((row[k] <= least[k] ? least[k] : row[k]) + TINY);
        for (int j = k; j < columns; ++j) {
            row[j] /= root;
        }
        for (int i = k + 1; i < N; ++i) {
            for (int j = k + 1; j < columns; ++j) {
                W[i * columns + j] -= row[i] * row[j];
            }
            W[i * columns + k] = 0;
        }
    }
}

static void cholesky(double *C, const double *S) /* upper triangular C with C'C = S positive semidefinite */
{
    double ridge[N];
    memcpy(C, S, NN * sizeof *C);
    for (int i = 0; i < N; ++i) {
        ridge[i] = RIDGE * S[i * N + i];
        C[i * N + i] += ridge[i];
    }
    eliminate(C, N, ridge);
}

static void half_kernel(double *Y, const double *G, const double *H) /* Y'Y = H (I + G H)^-1 */
{
    double C[NN], CG[NN], S[NN], W[2 * NN], least[N];
    cholesky(C, H);
    mul(CG, C, G);
    mul_transposed(S, CG, C);
    for (int i = 0; i < N; ++i) {
        least[i] = 1;
        for (int j = 0; j < N; ++j) {
            W[i * 2 * N + j] = (i == j) + S[i * N + j];
            W[i * 2 * N + N + j] = C[i * N + j];
        }
    }
    eliminate(W, 2 * N, least);
    for (int i = 0; i < N; ++i) {
        memcpy(Y + i * N, W + i * 2 * N + N, N * sizeof *Y);
    }
}

/* G and H become solutions near the limits of doubling: of the dual equation and of the equation. Spoils A. */
static void doubled(double *A, double *G, double *H)
{
    double Y[NN], YA[NN], AG[NN], AGY[NN], P[NN], S[NN], square[NN];
    for (int k = 0; k < DOUBLINGS; ++k) {
        half_kernel(Y, G, H);
        mul(YA, Y, A);
        mul(AG, A, G);
        mul_transposed(AGY, AG, Y);
        mul(square, A, A);
        mul(P, AGY, YA);
        for (int i = 0; i < NN; ++i) {
            square[i] -= P[i];
        }
        mul_transposed(P, AG, A);
        mul_transposed(S, AGY, AGY);
        for (int i = 0; i < NN; ++i) {
            G[i] = G[i] + P[i] - S[i];
        }
        transposed_mul(P, YA, YA);
        for (int i = 0; i < NN; ++i) {
            H[i] += P[i];
            A[i] = square[i];
        }
        const double size = size_of(A, NN);
        if (size < NEAR || !(size < DIVERGED)) {
            return;
        }
    }
}

/* S = R + C'S C by squaring C, which it spoils; returns whether C is stable. */
static int stein(double *S, double *C, const double *R)
{
    double P[NN], SC[NN];
    int stable = 0;
    memcpy(S, R, NN * sizeof *S);
    for (int k = 0; k < DOUBLINGS; ++k) {
        mul(SC, S, C);
        transposed_mul(P, C, SC);
        for (int i = 0; i < NN; ++i) {
            S[i] += P[i];
        }
        mul(P, C, C);
        memcpy(C, P, sizeof P);
        const double size = size_of(C, NN);
        stable = size < VANISHED;
        if (stable || !(size < DIVERGED)) {
            break;
        }
    }
    symmetrise(S);
    return stable;
}

/* Newton's method from X; returns whether X became a stabilising solution within so many steps. */
static int newton(const equation *e, double *X, int limit)
{
    double d[NN], left;
    for (int k = 0; k < limit; ++k) {
        const int stable = e->step(e, X, d, &left);
        for (int i = 0; i < NN; ++i) {
            X[i] += d[i];
        }
        const double size = size_of(X, NN);
        if (stable && left * size_of(d, NN) / (size + TINY) <= ACCURACY) {
            return 1;
        }
        if (!isfinite(size)) {
            return 0;
        }
    }
    return 0;
}
