/* x = [s; w] with dx = A x + B u, s = qv / (1 + q0) of the short way round. */
static void factorise(const double *y, double *x, double *A, double *B)
{
    const double side = y[0] < 0 ? -1 : 1;
    double left[9] = { 0 }, right[9], turn[9], square = 0;
    for (int i = 0; i < 3; ++i) {
        x[i] = side * y[1 + i] / (1 + side * y[0]);
        x[3 + i] = y[4 + i];
        square += x[i] * x[i];
    }
    cross(turn, x);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            right[3 * i + j] = ((i == j) * (1 - square) + 2 * turn[3 * i + j] + 2 * x[i] * x[j]) / 4;
        }
    }
    assemble(y + 4, left, right, A, B);
}
