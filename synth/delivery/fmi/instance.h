/*
 * One instance of a sampled controller, as both FMI versions need it. Included once per binary; model.h is written
 * by the exporter and names the controller.
 *
 * Sample k is taken at start + k * MODEL_SAMPLE_TIME. A step from t to t + h takes the samples in [t, t + h) with
 * the inputs set before the step; the outputs hold between samples. Value references: inputs, outputs, time.
 *
 * Inputs that are not finite are refused when they are set. Where the controller itself finds no command, as by overflow
 * in single precision, it holds its last one and the step ends with a warning.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#if defined _WIN32 || defined __CYGWIN__ /* a simulator finds what is marked so, and nothing else */
#define EXPORT __declspec(dllexport)
#elif defined __GNUC__
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard fixes the signatures */
#endif

#define TIME (MODEL_INPUTS + MODEL_OUTPUTS)
#define TOLERANCE (1e-6 * MODEL_SAMPLE_TIME) /* s, of a sample at the end of a step */

typedef struct {
    model_real y[MODEL_INPUTS];
    model_real u[MODEL_OUTPUTS];
    MODEL_STATE state;
    int fault;      /* 1 if the last step held a command */
    double start;   /* s, time of sample 0 */
    double samples; /* taken so far */
    double time;    /* s, end of the last step */
} controller_data;

static void data_reset(controller_data *data)
{
    memset(data->y, 0, sizeof data->y);
    MODEL_RESET(&data->state);
    memcpy(data->u, MODEL_COMMAND(data->state), sizeof data->u);
    data->fault = 0;
    data->samples = 0;
}

static void data_start(controller_data *data, double start)
{
    data->start = data->time = start;
}

/* Returns NULL, or what is wrong. */
static const char *data_step(controller_data *data, double t, double h)
{
    if (!isfinite(t) || !isfinite(h) || h <= 0) {
        return "the communication step is not positive";
    }
    data->fault = 0;
    while (data->start + data->samples * MODEL_SAMPLE_TIME < t + h - TOLERANCE) {
        data->fault |= MODEL_STEP(&data->state, data->y, data->u);
        data->samples += 1;
    }
    data->time = t + h;
    return NULL;
}

static const char *data_get(const controller_data *data, const unsigned vr[], size_t n, double values[])
{
    for (size_t i = 0; i < n; ++i) {
        if (vr[i] < MODEL_INPUTS) {
            values[i] = (double)data->y[vr[i]];
        } else if (vr[i] < TIME) {
            values[i] = (double)data->u[vr[i] - MODEL_INPUTS];
        } else if (vr[i] == TIME) {
            values[i] = data->time;
        } else {
            return "there is no variable with this value reference";
        }
    }
    return NULL;
}

static const char *data_set(controller_data *data, const unsigned vr[], size_t n, const double values[])
{
    for (size_t i = 0; i < n; ++i) {
        if (vr[i] >= MODEL_INPUTS) {
            return "only inputs can be set";
        }
        if (!isfinite(values[i])) {
            return "an input is not finite";
        }
        data->y[vr[i]] = (model_real)values[i];
    }
    return NULL;
}

#endif
