/* @title@: an FMU of FMI 3.0 for co-simulation (Functional Mock-up Interface Specification 3.0). */
#include "@name@.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define FMI3(type, name) __declspec(dllexport) type fmi3##name
#else
#define FMI3(type, name) __attribute__((visibility("default"))) type fmi3##name
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef void (*Logger)(void *environment, Status status, const char *category, const char *message);
enum { TIME, TORQUE, ATTITUDE = TORQUE + 3, RATE = ATTITUDE + 4, INERTIA = RATE + 3, STEP = INERTIA + 6, COUNT };
typedef struct {
    double value[COUNT], moments[3], axes[4]; /* variables by reference; of the inertia tensor */
    @name@_state free;
    bool stepping; /* after the initialisation */
} State;
typedef struct { State now; Logger log; void *environment; } Body;
static const State START = {{@start@}};
static Status failed(const Body *body, const char *message) {
    if (body->log) body->log(body->environment, ERROR, "logStatusError", message);
    return ERROR;
}
/* v rotated by q; by its inverse if hand is -1 */
static void rotate(const double *q, double hand, const double *v, double *out) {
    const double w = hand * q[0], *u = q + 1, along = 2 * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]);
    for (int k = 0, i = 1, j = 2; k < 3; i = j, j = k++)
        out[k] = (2 * w * w - 1) * v[k] + along * u[k] + 2 * w * (u[i] * v[j] - u[j] * v[i]);
}
FMI3(void *, InstantiateCoSimulation)(
    const char *name, const char *token, const char *resources, bool visible, bool logging, bool events, bool early,
    const uint32_t *intermediate, size_t count, void *environment, Logger log, void *update) {
    Body *body = token && strcmp(token, "@token@") == 0 ? malloc(sizeof *body) : NULL;
    if (body) *body = (Body){START, log, environment};
    return body;
}
FMI3(void, FreeInstance)(Body *body) { free(body); }
FMI3(Status, Reset)(Body *body) { return body->now = START, OK; }
FMI3(Status, EnterInitializationMode)(Body *body, bool toleranced, double tolerance, double start, bool ends, double end) {
    return body->now.value[TIME] = start, OK;
}
FMI3(Status, ExitInitializationMode)(Body *body) {
    State *s = &body->now;
    const double *q = s->value + ATTITUDE;
    double rate[3];
    @name@_constants c;
    @name@_principal(s->value + INERTIA, s->moments, s->axes);
    int status = @name@_check(s->moments, s->value[STEP]);
    if (status) return failed(body, @name@_message(status));
    if (!(s->value[STEP] > 0)) return failed(body, "step: expected a time > 0");
    if (!(fabs(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1) < 1e-6))
        return failed(body, "attitude: expected a unit quaternion");
    @name@_prepare(&c, s->moments, s->value[STEP]);
    rotate(q, 1, s->value + RATE, rate);
    @name@_set_motion(&c, &s->free, s->axes, q, rate);
    return s->stepping = true, OK;
}
FMI3(Status, GetFloat64)(Body *body, const uint32_t *references, size_t count, double *values, size_t size) {
    for (size_t i = 0; i < count; values[i] = body->now.value[references[i]], i++)
        if (references[i] >= COUNT || size != count) return failed(body, "expected a variable of the description");
    return OK;
}
FMI3(Status, SetFloat64)(Body *body, const uint32_t *references, size_t count, const double *values, size_t size) {
    for (size_t i = 0; i < count; body->now.value[references[i]] = values[i], i++) {
        uint32_t k = references[i];
        if (size != count || k < TORQUE || k >= COUNT || (body->now.stepping && k >= ATTITUDE))
            return failed(body, "expected a torque, or before the first step a start or a parameter");
        if (!isfinite(values[i])) return failed(body, "expected a finite number");
    }
    return OK;
}
FMI3(Status, DoStep)(
    Body *body, double time, double size, bool last, bool *event, bool *stop, bool *early, double *reached) {
    State s = body->now;
    double count = ceil(size / s.value[STEP] * (1 - 1e-12)), h = count > 0 ? size / count : 0, torque[3], rate[3];
    *event = *stop = *early = false, *reached = time;
    if (!s.stepping || !(size >= 0) || !(count < 9e15)) return failed(body, "expected a step size >= 0");
    @name@_constants c;
    @name@_prepare(&c, s.moments, h);
    rotate(s.axes, -1, s.value + TORQUE, torque);
    for (double i = 0; i < count; i++) { /* half of the impulse, the free motion, the other half */
        for (int k = 0; k < 3; k++) s.free.M[k] += 0.5 * h * torque[k];
        if (!(@name@_reach(&c, &s.free) <= 1)) return failed(body, "expected smaller angles in a step: decrease `step`");
        @name@_step(&c, &s.free);
        for (int k = 0; k < 3; k++) s.free.M[k] += 0.5 * h * torque[k];
    }
    @name@_get_motion(&c, &s.free, s.axes, s.value + ATTITUDE, rate);
    rotate(s.value + ATTITUDE, -1, rate, s.value + RATE);
    s.value[TIME] = *reached = time + size;
    return body->now = s, OK;
}
FMI3(Status, GetFMUState)(Body *body, State **saved) {
    if (!*saved) *saved = malloc(sizeof **saved);
    return *saved ? (**saved = body->now, OK) : failed(body, "expected memory for a state");
}
FMI3(Status, SetFMUState)(Body *body, const State *saved) { return body->now = *saved, OK; }
FMI3(Status, FreeFMUState)(Body *body, State **saved) { return free(*saved), *saved = NULL, OK; }
#define ALWAYS(type, name, value) FMI3(type, name)(void) { return value; }
ALWAYS(const char *, GetVersion, "3.0") ALWAYS(Status, Terminate, OK) ALWAYS(Status, SetDebugLogging, OK)
/* of other kinds of FMU, and of variables that this one does not have */
#define NO(name) ALWAYS(Status, name, ERROR)
#define KIND(name) NO(Get##name) NO(Set##name)
ALWAYS(void *, InstantiateModelExchange, NULL) ALWAYS(void *, InstantiateScheduledExecution, NULL)
KIND(Float32) KIND(Int8) KIND(UInt8) KIND(Int16) KIND(UInt16) KIND(Int32) KIND(UInt32) KIND(Int64) KIND(UInt64)
KIND(Boolean) KIND(String) KIND(Binary) KIND(Clock) KIND(IntervalDecimal) KIND(IntervalFraction) KIND(ShiftDecimal)
KIND(ShiftFraction) KIND(ContinuousStates) NO(EnterConfigurationMode) NO(ExitConfigurationMode) NO(EnterEventMode)
NO(EnterStepMode) NO(GetNumberOfVariableDependencies) NO(GetVariableDependencies) NO(SerializedFMUStateSize)
NO(SerializeFMUState) NO(DeserializeFMUState) NO(GetDirectionalDerivative) NO(GetAdjointDerivative)
NO(EvaluateDiscreteStates) NO(UpdateDiscreteStates) NO(EnterContinuousTimeMode) NO(CompletedIntegratorStep) NO(SetTime)
NO(GetContinuousStateDerivatives) NO(GetEventIndicators) NO(GetNominalsOfContinuousStates) NO(GetNumberOfEventIndicators)
NO(GetNumberOfContinuousStates) NO(GetOutputDerivatives) NO(ActivateModelPartition)
