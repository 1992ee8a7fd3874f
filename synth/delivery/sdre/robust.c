/* The gain R^-1 B'[(1 - g^-2) I - g^-2 X Z]^-1 X of Glover and McFarlane (1989), g^2 = gamma_factor^2 (1 + rho(X Z)). */

#define RADIUS_SQUARINGS 20 /* of X Z for its spectral radius, which is then right to 4e-7 */

static double trace_of(const double *S)
{
    double sum = S[0];
    for (int i = 1; i < N; ++i) {
        sum += S[i * (N + 1)];
    }
    return sum;
}

static double spectral_radius(const double *S)
{
    double P[NN], square[NN];
    double scale = trace_of(S) + TINY;
    for (int i = 0; i < NN; ++i) {
        P[i] = S[i] / scale;
    }
    for (int k = 0; k < RADIUS_SQUARINGS; ++k) {
        mul(square, P, P);
        scale = trace_of(square) + TINY;
        for (int i = 0; i < NN; ++i) {
            P[i] = square[i] / scale;
        }
    }
    mul(square, P, S);
    return trace_of(square) / (trace_of(P) + TINY);
}

static int gain_at(memory *state, const double *A, const double *B, double *K)
{
    double T[N * M], Kb[M * N], AT[NN], G[NN], X[NN], Z[NN], XZ[NN];
    const equation e = { kleinman, A, G, weight_Q, usual_rate }, dual = { kleinman, AT, weight_Q, G, usual_rate };
    (void)state;
    transposed(T, B, N, M);
    product(Kb, inverse_R, T, M, M, N);
    product(G, B, Kb, N, M, N);
    transposed(AT, A, N, N);
    neighbourhood(&e, X, Z);
    const int first = newton(&e, X, NEWTON_STEPS), second = newton(&dual, Z, NEWTON_STEPS);
    mul(XZ, X, Z);
    const double g2 = gamma_factor * gamma_factor * (1 + spectral_radius(XZ));
    for (int i = 0; i < NN; ++i) {
        XZ[i] = (i % (N + 1) == 0) * (1 - 1 / g2) - XZ[i] / g2;
    }
    solve(XZ, X, N, N);
    product(K, Kb, X, M, N, N);
    return first && second && finite(K, M * N);
}
