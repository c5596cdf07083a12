/* A gyroscope in a game loop: a free body whose spin does not turn over by itself.

    kreisel code examples/code/gyroscope.toml --method exact --name euler_top > euler_top.h
    gcc -std=c99 -O2 -march=native -ffp-contract=off gyroscope.c -o gyroscope -lm && ./gyroscope

Spun about its middle axis a body flips again and again; spun about another it never does. Game engines that step Euler's
equations by hand let the energy drift until every body spins about its largest moment, at L^2 / (2 I). Here energy and
momentum stay, for 10^9 steps (a year at 30 pictures a second) or for the number given on the command line.
*/
#include "euler_top.h"

#include <stdio.h>
#include <stdlib.h>

enum { W = 3, ENERGY = 8 }; /* places in the outputs: after M and g come the Casimir and the energy */

/* The third axis of the body in space, from the quaternion. */
static void axis(const double *q, double *out) {
    out[0] = 2.0 * (q[1] * q[3] + q[0] * q[2]);
    out[1] = 2.0 * (q[2] * q[3] - q[0] * q[1]);
    out[2] = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]);
}

int main(int count, char **words) {
    const long pictures = count > 1 ? atol(words[1]) : 1000000000L;
    static euler_top body;
    double out[sizeof(euler_top_START) / sizeof(double) + 16], first, a[3];

    euler_top_begin(&body, euler_top_START);
    euler_top_observe(&body, out);
    first = out[ENERGY];
    for (int k = 1; k <= 5; k++) {
        euler_top_advance(&body, pictures / 5); /* in a game: one step a picture */
        euler_top_observe(&body, out);
        axis(out + W, a);
        printf("after %11ld steps: axis %6.3f %6.3f %6.3f, energy changed by %.1e\n", k * (pictures / 5), a[0], a[1], a[2],
               out[ENERGY] / first - 1.0);
    }
    out[0] += 0.01; /* somebody kicks it: the momentum in the body changes, and the motion goes on from there */
    euler_top_begin(&body, out);
    euler_top_advance(&body, 30);
    euler_top_observe(&body, out);
    printf("kicked: energy %.6f, was %.6f\n", out[ENERGY], first);
    return 0;
}
