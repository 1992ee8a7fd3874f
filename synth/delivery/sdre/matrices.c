/* Matrices row by row; a sum begins with its first product and takes one rounded product after another. */

#define TINY 1e-300 /* keeps 0 / 0 from being one */

static void product(double *C, const double *A, const double *B, int rows, int inner, int columns) /* C = A B */
{
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < columns; ++j) {
            double sum = A[i * inner] * B[j];
            for (int k = 1; k < inner; ++k) {
                sum += A[i * inner + k] * B[k * columns + j];
            }
            C[i * columns + j] = sum;
        }
    }
}

static void transposed(double *T, const double *A, int rows, int columns) /* T = A' */
{
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < columns; ++j) {
            T[j * rows + i] = A[i * columns + j];
        }
    }
}

static double size_of(const double *A, int count) /* Frobenius norm */
{
    double sum = 0;
    for (int i = 0; i < count; ++i) {
        sum += A[i] * A[i];
    }
    return sqrt(sum);
}

static int finite(const double *A, int count)
{
    int all = 1;
    for (int i = 0; i < count; ++i) {
        all &= !!isfinite(A[i]);
    }
    return all;
}
