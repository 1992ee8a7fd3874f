/* x = [qv; w] with dx = A x + B u; |q0| is kept above the floor. */
static void factorise(const double *y, double *x, double *A, double *B)
{
    const double q0 = (y[0] < 0 ? -1 : 1) * (fabs(y[0]) > least_q0 ? fabs(y[0]) : least_q0);
    double left[9], right[9] = { 0 };
    cross(left, y + 4);
    for (int i = 0; i < 3; ++i) {
        x[i] = y[1 + i];
        x[3 + i] = y[4 + i];
        right[4 * i] = q0 / 2;
    }
    for (int i = 0; i < 9; ++i) {
        left[i] = -left[i] / 2;
    }
    assemble(y + 4, left, right, A, B);
}
