/* x = [angles - target; w] with dx = A x + B u; angles 3-2-1, which do not exist at a pitch of 90 deg. */
static void factorise(const double *y, double *x, double *A, double *B)
{
    const double s1 = sin(y[0]), c1 = cos(y[0]), s2 = sin(y[1]), c2 = cos(y[1]);
    const double E[9] = { 1, s1 * s2 / c2, c1 * s2 / c2, 0, c1, -s1, 0, s1 / c2, c1 / c2 };
    double v[3], turn[9], spin[9];
    product(v, inertia, y + 3, 3, 3, 1);
    for (int i = 0; i < 3; ++i) {
        x[i] = y[i] - angles[i];
        x[3 + i] = y[3 + i];
        v[i] += y[6 + i];
    }
    cross(turn, v);
    product(spin, inverse, turn, 3, 3, 3);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            A[i * N + j] = A[(3 + i) * N + j] = B[i * M + j] = 0;
            A[i * N + 3 + j] = E[3 * i + j];
            A[(3 + i) * N + 3 + j] = spin[3 * i + j];
            B[(3 + i) * M + j] = inverse[3 * i + j];
        }
    }
}
