#include "head.h"

#include <stdbool.h>

#ifdef TF_SINGLE
#define STEPS 12 /* of the integration over the angle; even */
#else
#define STEPS 48
#endif

static const real PSD_DISTANCE = (real)0.25;
static const real SIGMA = (real)0.115e-3; /* of the intensity: half the radius of 1/e^2 */
static const real PI = (real)3.14159265358979323846;
static const real ROOT_HALF = (real)0.70710678118654752440;

typedef struct {
    real x, y, z;
} vec;

static real dot(vec a, vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static vec along(vec p, real s, vec d)
{
    vec r = {p.x + s * d.x, p.y + s * d.y, p.z + s * d.z};
    return r;
}

/* Rotates (*a, *b) in their plane. */
static void turn(real *a, real *b, real angle)
{
    real c = REAL(cos)(angle), s = REAL(sin)(angle), first = *a;
    *a = first * c - *b * s;
    *b = first * s + *b * c;
}

static vec rotated(const head_pose *p, vec a)
{
    turn(&a.y, &a.z, p->roll);
    turn(&a.z, &a.x, p->pitch);
    turn(&a.x, &a.y, p->yaw);
    return a;
}

static real azimuth(int i)
{
    return i == 0 ? 0 : i == 1 ? 2 * PI / 3 : -2 * PI / 3;
}

/* Height of facet `n` over the point (x, y) seen from the apex. */
static real height(vec n, real x, real y)
{
    return -(n.x * x + n.y * y) / n.z;
}

/* Direction, seen from above, of the edge between facets a and b: both have the same height there, and the third
 * one is higher. */
static real edge(vec a, vec b, vec third)
{
    real x = -(a.y / a.z - b.y / b.z), y = a.x / a.z - b.x / b.z;
    bool away = height(third, x, y) < height(a, x, y);
    return away ? REAL(atan2)(-y, -x) : REAL(atan2)(y, x);
}

/* Integrals over the radius, from `chip` to infinity, of r g and r r g, where g is the density of the beam along the
 * direction to[]; lengths in units of SIGMA. */
static void radial(const real to[2], const real d[2], real chip, real *first, real *second)
{
    real b = d[0] * to[0] + d[1] * to[1], across = d[0] * to[1] - d[1] * to[0];
    real tail = REAL(sqrt)(PI / 2) * REAL(erfc)((chip - b) * ROOT_HALF);
    real border = REAL(exp)(-(chip - b) * (chip - b) / 2);
    real density = REAL(exp)(-across * across / 2) / (2 * PI);
    real one = border + b * tail;
    *first = density * one;
    *second = density * (chip * border + tail + b * one);
}

/* Power of a wedge of the beam and its centroid relative to the apex (Simpson's rule). */
static real wedge(real lo, real hi, const real d[2], real chip, real centroid[2])
{
    real power = 0, x = 0, y = 0, step = (hi - lo) / STEPS;
    for (int k = 0; k <= STEPS; k++) {
        real th = lo + (real)k * step, to[2] = {REAL(cos)(th), REAL(sin)(th)}, first, second;
        real weight = (real)(k == 0 || k == STEPS ? 1 : k % 2 == 1 ? 4 : 2) * step / 3;
        radial(to, d, chip, &first, &second);
        power += weight * first;
        x += weight * second * to[0];
        y += weight * second * to[1];
    }
    centroid[0] = power > 0 ? SIGMA * x / power : 0;
    centroid[1] = power > 0 ? SIGMA * y / power : 0;
    return power;
}

/* The ray that falls down onto the point p of facet n meets PSD i at (u, v). */
static void trace(int i, vec n, vec p, real at[2])
{
    real cosine = REAL(cos)(azimuth(i)), sine = REAL(sin)(azimuth(i));
    vec down = {0, 0, -1}, origin = {PSD_DISTANCE * cosine, PSD_DISTANCE * sine, 0};
    vec inwards = {-cosine, -sine, 0}, sideways = {sine, -cosine, 0}; /* x and y = z cross x of the PSD */
    vec ray = along(down, -2 * dot(n, down), n);
    real distance = dot(along(origin, -1, p), inwards) / dot(ray, inwards);
    vec hit = along(along(p, distance, ray), -1, origin);
    at[0] = dot(hit, sideways);
    at[1] = hit.z;
}

void head_light(const head_pose *pose, const real beam[2], real chip, head_spot spots[3])
{
    vec n[3];
    for (int i = 0; i < 3; i++) {
        vec flat = {REAL(cos)(azimuth(i)) * ROOT_HALF, REAL(sin)(azimuth(i)) * ROOT_HALF, ROOT_HALF};
        n[i] = rotated(pose, flat);
    }
    real d[2] = {(beam[0] - pose->t[0]) / SIGMA, (beam[1] - pose->t[1]) / SIGMA};
    for (int i = 0; i < 3; i++) {
        int next = (i + 1) % 3, last = (i + 2) % 3;
        real lo = edge(n[i], n[last], n[next]), hi = edge(n[i], n[next], n[last]), rho[2];
        spots[i].power = wedge(lo, hi < lo ? hi + 2 * PI : hi, d, chip / SIGMA, rho);
        vec apex = {pose->t[0], pose->t[1], pose->t[2]}, from_apex = {rho[0], rho[1], height(n[i], rho[0], rho[1])};
        trace(i, n[i], along(apex, 1, from_apex), spots[i].at);
    }
}
