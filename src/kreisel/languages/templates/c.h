@@ head
/*
@head@

@licence@

    @name@ body;
    @name@_begin(&body, @name@_START);      from a state
    @name@_advance(&body, 1000);            so many steps
    double out[@outputs@];
    @name@_observe(&body, out);             state, Casimirs, integrals

C99.  Compile with -ffp-contract=off, so that products are fused where the text says so and nowhere else, and with -mfma
or -march=native where the processor has fma: without, each fma is a call.
*/
#ifdef KREISEL_@name@_H
#if KREISEL_@name@_H != 0x@digest@
#error "two bodies are called @name@: give one of the files another name, kreisel code --name"
#endif
#else
#define KREISEL_@name@_H 0x@digest@

#include <math.h>

@@ helpers
#ifndef KREISEL_HELPERS
#define KREISEL_HELPERS
#if defined(__GNUC__)
#define KREISEL_FUNCTION static __attribute__((unused))
#else
#define KREISEL_FUNCTION static
#endif
#define kreisel_size(x) fabs(x)
#define kreisel_min(x, y) ((x) < (y) ? (x) : (y))
static inline double kreisel_max(double x, double y) { return y > x ? y : x; }
static inline double kreisel_sign(double x) { return x < 0.0 ? -1.0 : 1.0; }
static inline double kreisel_where_less(double x, double y, double yes, double no) { return x < y ? yes : no; }
#endif

@@ projected
typedef struct {
    double z[@size@]; /* the method's own variables */
    long done; /* steps since the last projection */
    double targets[4 * @invariants@], worst[@invariants@]; /* of the invariants; worst in units of 2^-52 |z| */
    double bound[4 * @bonds@ + 1], spare[@bonds@ + 1]; /* of the orientation */
    double room[@room@];
} @name@;

KREISEL_FUNCTION void @name@_project(@name@ *body, int begin) {
    @calls@
}

KREISEL_FUNCTION void @name@_begin(@name@ *body, const double x[@given@]) {
    @name@_open_state(x, body->z);
    body->done = 0;
    for (long i = 0; i < 4 * @invariants@; i++) body->targets[i] = 0.0;
    for (long i = 0; i < @invariants@; i++) body->worst[i] = 0.0;
    for (long i = 0; i <= 4 * @bonds@; i++) body->bound[i] = 0.0;
    for (long i = 0; i <= @bonds@; i++) body->spare[i] = 0.0;
    @name@_project(body, 1);
}

KREISEL_FUNCTION void @name@_advance(@name@ *body, long steps) {
    while (steps > 0) {
        long count = kreisel_min(steps, @every@ - body->done);
        for (long i = 0; i < count; i++) @name@_step(body->z);
        steps -= count;
        body->done += count;
        if (body->done == @every@) {
            body->done = 0;
            @name@_project(body, 0);
        }
    }
}

@@ plain
typedef struct {
    double z[@size@]; /* the method's own variables */
} @name@;

KREISEL_FUNCTION void @name@_begin(@name@ *body, const double x[@given@]) { @name@_open_state(x, body->z); }

KREISEL_FUNCTION void @name@_advance(@name@ *body, long steps) {
    for (long i = 0; i < steps; i++) @name@_step(body->z);
}

@@ back
KREISEL_FUNCTION void @name@_back(@name@ *body, long steps) {
    for (long i = 0; i < steps; i++) @name@_step_back(body->z);
}

@@ end
KREISEL_FUNCTION void @name@_observe(const @name@ *body, double out[@outputs@]) {
    @name@_outputs(body->z, out);
}

#endif
@@ call
if (begin) @name@_begin_projection_@k@(body->z, body->@targets@, body->@worst@, body->room);
    else @name@_project_@k@(body->z, body->@targets@, body->@worst@, body->room);
@@ def map
KREISEL_FUNCTION void @name@_@function@(const double *restrict @source@, double *restrict @target@) {
@@ def inplace
KREISEL_FUNCTION void @name@_@function@(double *restrict z) {
@@ def stage
@table@[stage][@j@]
@@ def project
KREISEL_FUNCTION void @name@_@function@(double *z, double *targets, double *worst, double *room) {
    (void)worst;
    (void)room;
