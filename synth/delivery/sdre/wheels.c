/* A = [[left, right], [0, Ib^-1 ([hw x] - [w x] Ib)]], B = [0; Ib^-1]. */
static void assemble(const double *w, const double *left, const double *right, double *A, double *B)
{
    double turn[9], held[9], spin[9];
    cross(turn, w);
    product(spin, turn, inertia, 3, 3, 3);
    cross(held, w + 3);
    for (int i = 0; i < 9; ++i) {
        held[i] -= spin[i];
    }
    product(spin, inverse, held, 3, 3, 3);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            A[i * N + j] = left[3 * i + j];
            A[i * N + 3 + j] = right[3 * i + j];
            A[(3 + i) * N + j] = B[i * M + j] = 0;
            A[(3 + i) * N + 3 + j] = spin[3 * i + j];
            B[(3 + i) * M + j] = inverse[3 * i + j];
        }
    }
}
