// Moser and Veselov's map of the Euler top, n = 3, as such code is usually written: Newton's method for the quaternion
// (q0, q) of the turn, eps mu = 2 (q0 I q + q x I q), from q = eps mu/(2 I); then mu turns.
// [McLachlan, Zanna 2005]

typedef double Real;
#include "maps.hpp"

static const int NEWTON = 4;

static Vec solve(Vec a, Vec b, Vec c, Vec r) { // columns a, b, c; Cramer's rule
    Vec bc = cross(b, c), ca = cross(c, a), ab = cross(a, b);
    Real scale = 1 / dot(a, bc);
    return {scale * dot(r, bc), scale * dot(r, ca), scale * dot(r, ab)};
}

static Vec step(Vec mu, Vec I, Real eps) {
    Vec half = eps / 2 * mu, q = {half.x / I.x, half.y / I.y, half.z / I.z};
    Real q0 = 1;
    for (int k = 0; k < NEWTON; ++k) {
        q0 = __builtin_sqrt(1 - dot(q, q));
        Vec Iq = I * q, r = q0 * Iq + cross(q, Iq) - half;
        Real s = -1 / q0;
        Vec a = {q0 * I.x + s * Iq.x * q.x, s * Iq.y * q.x - Iq.z + I.x * q.z, s * Iq.z * q.x + Iq.y - I.x * q.y};
        Vec b = {s * Iq.x * q.y + Iq.z - I.y * q.z, q0 * I.y + s * Iq.y * q.y, s * Iq.z * q.y - Iq.x + I.y * q.x};
        Vec c = {s * Iq.x * q.z - Iq.y + I.z * q.y, s * Iq.y * q.z + Iq.x - I.z * q.x, q0 * I.z + s * Iq.z * q.z};
        q = q - solve(a, b, c, r);
    }
    q0 = __builtin_sqrt(1 - dot(q, q));
    Vec t = 2.0 * cross(mu, q); // the turn back, W^T mu
    return mu + q0 * t - cross(q, t);
}

extern "C" void moser_veselov(double *z, const double *c, long lanes, long steps) {
    Vec I = {c[0], c[1], c[2]};
    for (long lane = 0; lane < lanes; ++lane) {
        Vec mu = axial_at(z + 3 * lane);
        for (long k = 0; k < steps; ++k)
            mu = step(mu, I, c[3]);
        put_axial(z + 3 * lane, mu);
    }
}
