#define _XOPEN_SOURCE 600
#include "head.h"

#include <math.h>

#define PSD_DISTANCE 0.25
#define BEAM_RADIUS 0.23e-3 /* of 1/e^2 of the intensity: two standard deviations */
#define SIGMA (BEAM_RADIUS / 2)
#define STEPS 48 /* of the integration over the angle; even */

static const double PI = 3.14159265358979323846;

typedef struct {
    double x, y, z;
} vec;

static double dot(vec a, vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static vec along(vec p, double s, vec d)
{
    vec r = {p.x + s * d.x, p.y + s * d.y, p.z + s * d.z};
    return r;
}

static vec rotated(const head_pose *p, vec a)
{
    vec r = {a.x, a.y * cos(p->roll) - a.z * sin(p->roll), a.y * sin(p->roll) + a.z * cos(p->roll)};
    vec q = {r.x * cos(p->pitch) + r.z * sin(p->pitch), r.y, r.z * cos(p->pitch) - r.x * sin(p->pitch)};
    vec w = {q.x * cos(p->yaw) - q.y * sin(p->yaw), q.x * sin(p->yaw) + q.y * cos(p->yaw), q.z};
    return w;
}

static double azimuth(int i)
{
    return i == 0 ? 0.0 : i == 1 ? 2 * PI / 3 : -2 * PI / 3;
}

/* Height of facet `n` over the point (x, y) seen from the apex. */
static double height(vec n, double x, double y)
{
    return -(n.x * x + n.y * y) / n.z;
}

/* Direction, seen from above, of the edge between facets a and b: both have the same height there, and the third
 * one is higher. */
static double edge(vec a, vec b, vec third)
{
    double x = -(a.y / a.z - b.y / b.z), y = a.x / a.z - b.x / b.z;
    bool away = height(third, x, y) < height(a, x, y);
    return away ? atan2(-y, -x) : atan2(y, x);
}

/* Integrals over the radius, from `chip` to infinity, of r g and r r g, where g is the density of the beam along the
 * direction th; lengths in units of SIGMA. */
static void radial(double th, const double d[2], double chip, double *first, double *second)
{
    double b = d[0] * cos(th) + d[1] * sin(th), across = d[0] * sin(th) - d[1] * cos(th);
    double tail = sqrt(PI / 2) * erfc((chip - b) / sqrt(2.0)), border = exp(-(chip - b) * (chip - b) / 2);
    double density = exp(-across * across / 2) / (2 * PI);
    double one = border + b * tail;
    *first = density * one;
    *second = density * (chip * border + tail + b * one);
}

/* Power of a wedge of the beam and its centroid relative to the apex (Simpson's rule). */
static double wedge(double lo, double hi, const double d[2], double chip, double centroid[2])
{
    double power = 0, x = 0, y = 0, step = (hi - lo) / STEPS;
    for (int k = 0; k <= STEPS; k++) {
        double th = lo + k * step, first, second;
        double weight = (k == 0 || k == STEPS ? 1.0 : k % 2 == 1 ? 4.0 : 2.0) * step / 3;
        radial(th, d, chip, &first, &second);
        power += weight * first;
        x += weight * second * cos(th);
        y += weight * second * sin(th);
    }
    centroid[0] = power > 0 ? SIGMA * x / power : 0;
    centroid[1] = power > 0 ? SIGMA * y / power : 0;
    return power;
}

/* The ray that falls down onto the point p of facet n meets PSD i at (u, v). */
static void trace(int i, vec n, vec p, double at[2])
{
    double az = azimuth(i);
    vec down = {0, 0, -1}, origin = {PSD_DISTANCE * cos(az), PSD_DISTANCE * sin(az), 0};
    vec inwards = {-cos(az), -sin(az), 0}, sideways = {sin(az), -cos(az), 0}; /* x and y = z cross x of the PSD */
    vec ray = along(down, -2 * dot(n, down), n);
    double s = dot(along(origin, -1, p), inwards) / dot(ray, inwards);
    vec hit = along(along(p, s, ray), -1, origin);
    at[0] = dot(hit, sideways);
    at[1] = hit.z;
}

void head_light(const head_pose *pose, const double beam[2], double chip, head_spot spots[3])
{
    vec n[3];
    for (int i = 0; i < 3; i++) {
        vec flat = {cos(azimuth(i)) / sqrt(2.0), sin(azimuth(i)) / sqrt(2.0), 1 / sqrt(2.0)};
        n[i] = rotated(pose, flat);
    }
    double d[2] = {(beam[0] - pose->t[0]) / SIGMA, (beam[1] - pose->t[1]) / SIGMA};
    for (int i = 0; i < 3; i++) {
        int next = (i + 1) % 3, last = (i + 2) % 3;
        double lo = edge(n[i], n[last], n[next]), hi = edge(n[i], n[next], n[last]), rho[2];
        spots[i].power = wedge(lo, hi < lo ? hi + 2 * PI : hi, d, chip / SIGMA, rho);
        vec apex = {pose->t[0], pose->t[1], pose->t[2]}, from_apex = {rho[0], rho[1], height(n[i], rho[0], rho[1])};
        trace(i, n[i], along(apex, 1, from_apex), spots[i].at);
    }
}
