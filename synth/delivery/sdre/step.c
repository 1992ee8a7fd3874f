static double limited(double v, int i)
{
    return v < umin[i] ? umin[i] : v > umax[i] ? umax[i] : v;
}

static int stepped(memory *state, const double *y, double *u)
{
    double x[N], A[N * N], B[N * M], K[M * N], command[M];
    int fault = !finite(y, INPUTS), ok = 0;
    if (!fault) {
        factorise(y, x, A, B);
        ok = gain_at(state, A, B, K);
        if (ok) {
            memcpy(state->gain, K, sizeof K);
        }
        product(command, state->gain, x, M, N, 1);
        fault = !finite(command, M);
    }
    state->failures += !ok;
    for (int i = 0; i < M; ++i) {
        state->u[i] = fault ? state->u[i] : limited(-command[i], i);
        u[i] = state->u[i];
    }
    return fault;
}
