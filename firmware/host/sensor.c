#define _XOPEN_SOURCE 600
#include "sensor.h"

#include <math.h>

#define HALF_SIZE 6.5e-3        /* half the side of a PSD, metres */
#define FULL_SCALE_V 10.0       /* of the position at the edge */
#define LASER_V (0.6 / 0.0667)  /* sum voltage for the whole beam: 0.6 mW at 0.0667 mW per volt */
#define READBACK_PER_V 50e-6    /* metres */
#define LAG_S 0.5e-3            /* of the stage */

static const double PI = 3.14159265358979323846;

double sensor_random(sensor *s)
{
    s->random = s->random * 6364136223846793005u + 1442695040888963407u;
    return (double)(s->random >> 11) / 9007199254740992.0;
}

static double normal(sensor *s)
{
    double a = sensor_random(s), b = sensor_random(s);
    return sqrt(-2 * log(1 - a)) * cos(2 * PI * b);
}

bool sensor_faulty(const options *o, uint32_t sequence)
{
    return sequence >= o->at && sequence < o->until;
}

head_pose sensor_pose(const options *o, double t)
{
    double m = o->motion;
    head_pose p = {{60e-6 * m * sin(2 * PI * 0.31 * t), 45e-6 * m * sin(2 * PI * 0.23 * t + 1),
                    25e-6 * m * sin(2 * PI * 0.41 * t + 2)},
                   90e-6 * m * sin(2 * PI * 0.27 * t + 3),
                   70e-6 * m * sin(2 * PI * 0.37 * t + 4) + o->pitch_urad * 1e-6,
                   120e-6 * m * sin(2 * PI * 0.19 * t + 5)};
    return p;
}

/* Relative power of the laser. */
static double power(const options *o, double t, double from_s)
{
    double part = o->fade_s > 0 ? fmin((t - from_s) / o->fade_s, 1) : 1;
    return (1 + part * (o->power - 1)) * (1 + o->flicker * sin(2 * PI * o->flicker_hz * t));
}

static int32_t code(const options *o, double volts)
{
    double full = ldexp(1, (int)o->bits - 1), value = floor(volts * 1000 / o->range_mv * full + 0.5);
    return (int32_t)fmax(-full, fmin(full - 1, value));
}

/* The scan before its faults in the electronics. */
typedef struct {
    double t, from_s; /* of the channel and of the begin of the faults, seconds */
    bool faulty, blocked;
    double beam[2];
    head_spot spots[3];
} moment;

static double volts_of_light(sensor *s, const options *o, int channel, const moment *m)
{
    int i = channel / 3, part = channel % 3;
    double factor = m->blocked ? 0 : m->faulty ? power(o, m->t, m->from_s) : 1;
    double light = LASER_V * m->spots[i].power * factor;
    double ambient = m->faulty ? LASER_V / 3 * (o->ambient + (i == 0 ? o->ambient_a : 0)) : 0;
    if (part == 2) {
        return light * (1 + o->power_noise * normal(s)) + ambient;
    }
    double displaced = m->faulty && i == 0 && part == 0 ? o->psd_um * 1e-6 : 0;
    double spot = m->spots[i].at[part] + displaced + o->spot_um * 1e-6 * normal(s);
    /* Ambient light is uniform: its centroid is the middle of the PSD. */
    return light > 0 ? FULL_SCALE_V / HALF_SIZE * spot * light / (light + ambient) : 0;
}

static void move_stage(sensor *s, const options *o, bool faulty, double period_s, const double command[2])
{
    for (int axis = 0; axis < 2; axis++) {
        double goal = s->command[axis] * (faulty ? o->polarity : 1);
        s->stage[axis] += (goal - s->stage[axis]) * (1 - exp(-period_s / LAG_S));
        s->command[axis] = command[axis];
        if (!(faulty && o->readback_stuck > 0)) {
            s->readback[axis] = s->stage[axis];
        }
    }
}

const int32_t *sensor_scan(sensor *s, const options *o, uint32_t sequence, double period_s, const double command[2])
{
    bool faulty = sensor_faulty(o, sequence);
    move_stage(s, o, faulty, period_s, command);
    bool blocked = sequence >= o->block_at && sequence < o->block_until;
    moment m = {.from_s = o->at * period_s, .faulty = faulty, .blocked = blocked,
                .beam = {s->stage[0] + (faulty ? o->laser_um * 1e-6 : 0), s->stage[1]}};
    for (int channel = 0; channel < SENSOR_CHANNELS; channel++) {
        m.t = sequence * period_s + channel * o->skew_us * 1e-6;
        if (channel == 0 || o->skew_us > 0) {
            head_pose pose = sensor_pose(o, m.t);
            head_light(&pose, m.beam, faulty ? o->chip_um * 1e-6 : 0, m.spots);
        }
        int axis = channel - 9;
        double volts = axis < 0 ? volts_of_light(s, o, channel, &m)
                                : (s->readback[axis] + o->readback_um * 1e-6 * normal(s)) / READBACK_PER_V;
        bool frozen = faulty && fmod(floor(o->freeze / ldexp(1, channel)), 2) > 0;
        s->codes[channel] = frozen ? s->codes[channel] : code(o, volts);
    }
    return s->codes;
}
