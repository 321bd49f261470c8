#include "sensor.h"

static const real HALF_SIZE = (real)6.5e-3;         /* half the side of a PSD, metres */
static const real FULL_SCALE_V = 10;                /* of the position at the edge */
static const real LASER_V = (real)(0.6 / 0.0667);   /* sum voltage for the whole beam: 0.6 mW at 0.0667 mW per volt */
static const real READBACK_PER_V = (real)50e-6;     /* metres */
static const real LAG_S = (real)0.5e-3;             /* of the stage */
static const real MICRO = (real)1e-6;
static const real PI = (real)3.14159265358979323846;

real sensor_random(sensor *s)
{
    s->random = s->random * 6364136223846793005u + 1442695040888963407u;
    return (real)(s->random >> 40) / 16777216; /* exact in single precision, too */
}

static real normal(sensor *s)
{
    real a = sensor_random(s), b = sensor_random(s);
    return REAL(sqrt)(-2 * REAL(log)(1 - a)) * REAL(cos)(2 * PI * b);
}

bool sensor_faulty(const options *o, uint32_t sequence)
{
    return (real)sequence >= o->at && (real)sequence < o->until;
}

head_pose sensor_pose(const options *o, real t)
{
    real micro = MICRO * o->motion, turn = 2 * PI * t / 100;
    head_pose p = {{60 * micro * REAL(sin)(31 * turn), 45 * micro * REAL(sin)(23 * turn + 1),
                    25 * micro * REAL(sin)(41 * turn + 2)},
                   90 * micro * REAL(sin)(27 * turn + 3),
                   70 * micro * REAL(sin)(37 * turn + 4) + o->pitch_urad * MICRO,
                   120 * micro * REAL(sin)(19 * turn + 5)};
    return p;
}

/* Relative power of the laser. */
static real power(const options *o, real t, real from_s)
{
    real part = o->fade_s > 0 ? REAL(fmin)((t - from_s) / o->fade_s, 1) : 1;
    return (1 + part * (o->power - 1)) * (1 + o->flicker * REAL(sin)(2 * PI * o->flicker_hz * t));
}

static int32_t code(const options *o, real volts)
{
    real full = REAL(ldexp)(1, (int)o->bits - 1), value = REAL(floor)(volts * 1000 / o->range_mv * full + (real)0.5);
    return (int32_t)REAL(fmax)(-full, REAL(fmin)(full - 1, value));
}

/* The scan before its faults in the electronics. */
typedef struct {
    real t, from_s; /* of the channel and of the begin of the faults, seconds */
    bool faulty, blocked;
    real beam[2];
    head_spot spots[3];
} moment;

static real volts_of_light(sensor *s, const options *o, int channel, const moment *m)
{
    int i = channel / 3, part = channel % 3;
    real factor = m->blocked ? 0 : m->faulty ? power(o, m->t, m->from_s) : 1;
    real light = LASER_V * m->spots[i].power * factor;
    real ambient = m->faulty ? LASER_V / 3 * (o->ambient + (i == 0 ? o->ambient_a : 0)) : 0;
    if (part == 2) {
        return light * (1 + o->power_noise * normal(s)) + ambient;
    }
    real displaced = m->faulty && i == 0 && part == 0 ? o->psd_um * MICRO : 0;
    real spot = m->spots[i].at[part] + displaced + o->spot_um * MICRO * normal(s);
    /* Ambient light is uniform: its centroid is the middle of the PSD. */
    return light > 0 ? FULL_SCALE_V / HALF_SIZE * spot * light / (light + ambient) : 0;
}

static void move_stage(sensor *s, const options *o, bool faulty, real period_s, const real command[2])
{
    for (int axis = 0; axis < 2; axis++) {
        real goal = s->command[axis] * (faulty ? o->polarity : 1);
        s->stage[axis] += (goal - s->stage[axis]) * (1 - REAL(exp)(-period_s / LAG_S));
        s->command[axis] = command[axis];
        if (!(faulty && o->readback_stuck > 0)) {
            s->readback[axis] = s->stage[axis];
        }
    }
}

const int32_t *sensor_scan(sensor *s, const options *o, uint32_t sequence, real period_s, const real command[2])
{
    bool faulty = sensor_faulty(o, sequence);
    move_stage(s, o, faulty, period_s, command);
    bool blocked = (real)sequence >= o->block_at && (real)sequence < o->block_until;
    moment m = {.from_s = o->at * period_s, .faulty = faulty, .blocked = blocked,
                .beam = {s->stage[0] + (faulty ? o->laser_um * MICRO : 0), s->stage[1]}};
    for (int channel = 0; channel < SENSOR_CHANNELS; channel++) {
        m.t = (real)sequence * period_s + (real)channel * o->skew_us * MICRO;
        if (channel == 0 || o->skew_us > 0) {
            head_pose pose = sensor_pose(o, m.t);
            head_light(&pose, m.beam, faulty ? o->chip_um * MICRO : 0, m.spots);
        }
        int axis = channel - 9;
        real volts = axis < 0 ? volts_of_light(s, o, channel, &m)
                                : (s->readback[axis] + o->readback_um * MICRO * normal(s)) / READBACK_PER_V;
        bool frozen = faulty && REAL(fmod)(REAL(floor)(o->freeze / REAL(ldexp)(1, channel)), 2) > 0;
        s->codes[channel] = frozen ? s->codes[channel] : code(o, volts);
    }
    return s->codes;
}
