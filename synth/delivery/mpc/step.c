void mpc_reset(mpc_state *state)
{
    memset(state, 0, sizeof *state);
}

int mpc_step(mpc_state *state, const double y[MPC_STATES], const double r[MPC_STATES], double u[MPC_OUTPUTS])
{
    double phi[MPC_PARAMETERS], square = 0, acting[MPC_OUTPUTS];
    int at = 0, status = MPC_SOLVED;

    for (int i = 0; i < MPC_STATES; ++i) {
        phi[at++] = y[i];
    }
#if MPC_VELOCITY
    for (int i = 0; i < MPC_STATES; ++i) {
        phi[at++] = state->known ? y[i] - state->forecast[i] : 0;
    }
#endif
    for (int i = 0; i < MPC_STATES; ++i) {
        phi[at++] = r[i];
    }
    for (int i = 0; i < MPC_OUTPUTS; ++i) {
        phi[at++] = state->momentum[i];
    }
    for (int k = 0; k < MPC_MEMORY; ++k) {
        for (int i = 0; i < MPC_OUTPUTS; ++i) {
            phi[at++] = state->inputs[k][i];
        }
    }
    for (int i = 0; i < MPC_PARAMETERS; ++i) {
        square += phi[i] * phi[i];
    }
    if (!isfinite(square)) {
        status = MPC_BAD_DATA;
    } else {
        for (int i = 0; i < MPC_VARIABLES; ++i) {
            state->f[i] = f_offset[i];
            for (int j = 0; j < MPC_PARAMETERS; ++j) {
                state->f[i] += f_slope[i][j] * phi[j];
            }
        }
        for (int i = 0; i < MPC_ROWS; ++i) {
            state->b[i] = b_offset[i];
            for (int j = 0; j < MPC_PARAMETERS; ++j) {
                state->b[i] += b_slope[i][j] * phi[j];
            }
        }
        status = solved(state);
    }
    for (int i = 0; i < MPC_OUTPUTS; ++i) {
        u[i] = status == MPC_SOLVED || status == MPC_ROUGH ? unit[i] * state->v[i] : state->inputs[MPC_MEMORY - 1][i];
        u[i] = u[i] > umax[i] ? umax[i] : u[i] < umin[i] ? umin[i] : u[i];
        acting[i] = MPC_DELAY > 0 ? state->inputs[0][i] : u[i];
        state->momentum[i] -= MPC_SAMPLE_TIME * acting[i];
    }
#if MPC_VELOCITY
    state->known = status != MPC_BAD_DATA;
    for (int i = 0; i < MPC_STATES; ++i) {
        state->forecast[i] = 0;
        for (int j = 0; state->known && j < MPC_STATES; ++j) {
            state->forecast[i] += plant_A[i][j] * y[j];
        }
        for (int j = 0; state->known && j < MPC_OUTPUTS; ++j) {
            state->forecast[i] += plant_B[i][j] * acting[j];
        }
    }
#endif
    for (int k = 0; k + 1 < MPC_MEMORY; ++k) {
        memcpy(state->inputs[k], state->inputs[k + 1], sizeof state->inputs[k]);
    }
    memcpy(state->inputs[MPC_MEMORY - 1], u, sizeof state->inputs[0]);
    return status;
}
