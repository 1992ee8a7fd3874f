/* F becomes S^-1 F by elimination with row pivots, which spoils S (rows, rows); F has so many columns. */
static void solve(double *S, double *F, int rows, int columns)
{
    for (int k = 0; k < rows; ++k) {
        int pivot = k;
        for (int i = k + 1; i < rows; ++i) {
            pivot = fabs(S[i * rows + k]) > fabs(S[pivot * rows + k]) ? i : pivot;
        }
        for (int j = 0; j < rows; ++j) {
            const double moved = S[k * rows + j];
            S[k * rows + j] = S[pivot * rows + j];
            S[pivot * rows + j] = moved;
        }
        for (int j = 0; j < columns; ++j) {
            const double moved = F[k * columns + j];
            F[k * columns + j] = F[pivot * columns + j];
            F[pivot * columns + j] = moved;
        }
        for (int i = k + 1; i < rows; ++i) {
            const double factor = S[i * rows + k] / S[k * rows + k];
            for (int j = k + 1; j < rows; ++j) {
                S[i * rows + j] -= factor * S[k * rows + j];
            }
            for (int j = 0; j < columns; ++j) {
                F[i * columns + j] -= factor * F[k * columns + j];
            }
        }
    }
    for (int k = rows - 1; k >= 0; --k) {
        for (int j = 0; j < columns; ++j) {
            for (int i = k + 1; i < rows; ++i) {
                F[k * columns + j] -= S[k * rows + i] * F[i * columns + j];
            }
            F[k * columns + j] /= S[k * rows + k];
        }
    }
}
