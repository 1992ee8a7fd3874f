/* The gain R^-1 B'X of the solution that continues the last two in a line, or else of one found from nothing. */

#define WARM_STEPS 3 /* from a guess; one that needs more is no guess */

static int gain_at(memory *state, const double *A, const double *B, double *K)
{
    double T[N * M], Kb[M * N], G[NN], X[NN], Z[NN];
    const equation e = { kleinman, A, G, weight_Q, usual_rate };
    transposed(T, B, N, M);
    product(Kb, inverse_R, T, M, M, N);
    product(G, B, Kb, N, M, N);
    for (int i = 0; i < NN; ++i) {
        X[i] = 2 * state->X[i] - state->before[i];
    }
    int ok = newton(&e, X, WARM_STEPS);
    if (!ok) {
        neighbourhood(&e, X, Z);
        ok = newton(&e, X, NEWTON_STEPS);
    }
    product(K, Kb, X, M, N, N);
    if (ok) {
        memcpy(state->before, state->X, sizeof X);
        memcpy(state->X, X, sizeof X);
    }
    return ok;
}
