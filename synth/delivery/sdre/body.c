static void cross(double *T, const double *v) /* T = [v x] */
{
    const double turn[9] = { 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0 };
    memcpy(T, turn, sizeof turn);
}
