/* The sensor of the board: the mirror moves, the stage follows its outputs, the converter samples. */
#ifndef TF_SENSOR_H
#define TF_SENSOR_H

#include <stdbool.h>
#include <stdint.h>

#include "head.h"
#include "options.h"

#define SENSOR_CHANNELS 11

/* The state of the sensor. All bytes zero is its initial state. */
typedef struct {
    real stage[2];   /* position, metres */
    real command[2]; /* of the previous scan: the stage answers one scan later */
    int32_t codes[SENSOR_CHANNELS];
    real readback[2];
    uint64_t random;
} sensor;

/* The true pose of the mirror, seconds after START. */
head_pose sensor_pose(const options *o, real time_s);

/* Samples all channels (u, v, sum of A, B, C; readback x, y) in the scan with this number. `command` is the
 * position of the outputs in metres, `period_s` the time since the previous scan. */
const int32_t *sensor_scan(sensor *s, const options *o, uint32_t sequence, real period_s, const real command[2]);

/* A random number from 0 to 1. */
real sensor_random(sensor *s);

/* Whether faults act in this scan. */
bool sensor_faulty(const options *o, uint32_t sequence);

#endif
