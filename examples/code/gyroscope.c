/* A gyroscope in a game loop: a free body whose spin does not turn over by itself.

    kreisel code free-body --name rock > rock.h
    gcc -std=c99 -O2 -march=native -ffp-contract=off -fno-math-errno gyroscope.c -o gyroscope -lm && ./gyroscope

Spun about its middle axis a body flips again and again; spun about another it never does. Game engines that step Euler's
equations by hand let the energy drift until every body spins about its largest moment, at L^2 / (2 I). Here energy and
momentum stay, for 10^8 steps (a month at 30 pictures a second) or for the number given on the command line.
*/
#include "rock.h"

#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words) {
    const long pictures = count > 1 ? atol(words[1]) : 100000000L;
    const double moments[3] = {5.5, 4.5, 3.0}, dt = 1.0 / 30.0;
    rock_constants c;
    rock_state s = {.M = {0.02, 4.5, 0.01}, .g = {1.0}};

    const int status = rock_check(moments, dt);
    if (status) {
        fprintf(stderr, "expected: %s\n", rock_message(status));
        return 1;
    }
    rock_prepare(&c, moments, dt);
    const double first = rock_energy(&c, &s);
    for (int k = 1; k <= 5; k++) {
        rock_advance(&c, &s, pictures / 5); /* in a game: one rock_step a picture */
        rock_hold(&c, &s);
        const double *q = s.g; /* the third axis of the body in space */
        printf("after %11ld steps: axis %6.3f %6.3f %6.3f, energy changed by %.1e\n", k * (pictures / 5),
               2.0 * (q[1] * q[3] + q[0] * q[2]), 2.0 * (q[2] * q[3] - q[0] * q[1]),
               1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]), rock_energy(&c, &s) / first - 1.0);
    }
    s.M[0] += 0.01; /* somebody kicks it: the momentum changes by the torque's impulse, and the motion goes on */
    rock_advance(&c, &s, 30);
    printf("kicked: energy %.6f, was %.6f\n", rock_energy(&c, &s), first);
    return 0;
}
