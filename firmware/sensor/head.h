/* The light of the sensor head: a Gaussian beam on a mirror of three facets, and its spots on three PSDs.
 *
 * Written from the definitions of docs/sensor-model.md only, with numerical integration instead of closed forms,
 * so that it can disagree with the daemon. Metres, radians; powers as fractions of the beam.
 */
#ifndef TF_HEAD_H
#define TF_HEAD_H

#include "real.h"

/* Position of the apex and rotation Rz(yaw) Ry(pitch) Rx(roll). */
typedef struct {
    real t[3], roll, pitch, yaw;
} head_pose;

/* The light on a PSD. */
typedef struct {
    real at[2]; /* u, v of the centroid */
    real power; /* fraction of the beam */
} head_spot;

/* Computes the three spots for a vertical beam with its centre at `beam` (world x, y). No light comes from the
 * mirror within the distance `chip` of its apex. */
void head_light(const head_pose *pose, const real beam[2], real chip, head_spot spots[3]);

#endif
