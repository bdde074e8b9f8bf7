/* The two tanks of fusion_sfdia.models.two_tanks as an FMU, of FMI 2.0 or 3.0 (-DFMI=2, -DFMI=3).

   Only what FMPy calls is here; all other functions of the standard are stubs that report an error, see tank_fmus.py.
   Value references: 0 time, 1 2 levels, 3 4 their derivatives, 5 inflow, 6 7 flows, 8 area, 9 10 outlets, 11 leak,
   12 lag: time constant of a hidden state of co-simulation, s; below 0 the time of an event of model exchange, negated. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
#define NAME(name) fmi2##name
typedef fmi2Component Instance;
typedef fmi2Status Status;
typedef fmi2ValueReference Reference;
#define OK fmi2OK
#define DISCARD fmi2Discard
#define FAILED fmi2Error
#else
#include "fmi3Functions.h"
#define NAME(name) fmi3##name
typedef fmi3Instance Instance;
typedef fmi3Status Status;
typedef fmi3ValueReference Reference;
#define OK fmi3OK
#define DISCARD fmi3Discard
#define FAILED fmi3Error
#endif

enum { LEVEL = 1, RATE = 3, INFLOW = 5, FLOW = 6, AREA = 8, OUTLET = 9, LEAK = 11, LAG = 12, COUNT = 13 };

typedef struct {
    double v[COUNT]; /* by value reference; flows and derivatives are computed when they are read */
    double hidden;   /* the inflow behind a lag, m3/s */
} Tanks;

static Status compute(Tanks *m) {
    double *v = m->v;
    double inflow = v[LAG] > 0 ? m->hidden : v[INFLOW];
    if (v[0] < 0 || v[LEVEL] < -1 || v[LEVEL + 1] < -1) return FAILED;
    if (v[LEVEL] < 0 || v[LEVEL + 1] < 0) return DISCARD;
    v[FLOW] = v[OUTLET] * sqrt(v[LEVEL]);
    v[FLOW + 1] = v[OUTLET + 1] * sqrt(v[LEVEL + 1]);
    v[RATE] = (inflow - v[FLOW]) / v[AREA];
    v[RATE + 1] = (v[FLOW] - v[FLOW + 1] - v[LEAK]) / v[AREA];
    return OK;
}

static void start(Tanks *m) {
    static const double usual[COUNT] = {0, 1, 1, 0, 0, 6e-4, 0, 0, 0.05, 6e-4, 6e-4, 0, 0};
    memcpy(m->v, usual, sizeof usual);
    m->hidden = usual[INFLOW];
}

static Tanks *new_tanks(void) {
    Tanks *m = malloc(sizeof *m);
    start(m);
    return m;
}

/* one step of Runge-Kutta 4 for both levels, for co-simulation */
static Status advance(Tanks *m, double dt) {
    static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
    double x[2] = {m->v[LEVEL], m->v[LEVEL + 1]}, k[2] = {0, 0}, sum[2] = {0, 0};
    if (m->v[LAG] > 0) m->hidden += (1 - exp(-dt / m->v[LAG])) * (m->v[INFLOW] - m->hidden);
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < 2; i++) m->v[LEVEL + i] = x[i] + at[stage] * dt * k[i];
        Status status = compute(m);
        if (status != OK) return status;
        for (int i = 0; i < 2; i++) {
            k[i] = m->v[RATE + i];
            sum[i] += weight[stage] * k[i];
        }
    }
    for (int i = 0; i < 2; i++) m->v[LEVEL + i] = x[i] + dt / 6 * sum[i];
    return compute(m);
}

/* what a change of one known changes: levels and inflow are known */
static double derivative(Tanks *m, Reference unknown, Reference known) {
    double *v = m->v, outflow[2];
    for (int i = 0; i < 2; i++) outflow[i] = v[OUTLET + i] / (2 * sqrt(v[LEVEL + i]));
    if (unknown == LEVEL || unknown == LEVEL + 1) return unknown == known;
    if (unknown == FLOW || unknown == FLOW + 1) return known == unknown - FLOW + LEVEL ? outflow[unknown - FLOW] : 0;
    if (unknown == RATE) return known == INFLOW ? 1 / v[AREA] : known == LEVEL ? -outflow[0] / v[AREA] : 0;
    return known == LEVEL ? outflow[0] / v[AREA] : known == LEVEL + 1 ? -outflow[1] / v[AREA] : 0;
}

void NAME(FreeInstance)(Instance c) { free(c); }
Status NAME(ExitInitializationMode)(Instance c) { return compute(c) == FAILED ? FAILED : OK; }
Status NAME(Terminate)(Instance c) { return OK; }
Status NAME(Reset)(Instance c) { start(c); return OK; }
Status NAME(EnterContinuousTimeMode)(Instance c) { return OK; }
Status NAME(SetTime)(Instance c, double t) { ((Tanks *)c)->v[0] = t; return OK; }

Status NAME(SetContinuousStates)(Instance c, const double x[], size_t n) {
    memcpy(((Tanks *)c)->v + LEVEL, x, n * sizeof *x);
    return OK;
}

Status NAME(GetContinuousStates)(Instance c, double x[], size_t n) {
    memcpy(x, ((Tanks *)c)->v + LEVEL, n * sizeof *x);
    return OK;
}

static Status rates(Instance c, double dx[], size_t n) {
    Status status = compute(c);
    memcpy(dx, ((Tanks *)c)->v + RATE, n * sizeof *dx);
    return status;
}

static Status get(Instance c, const Reference vr[], size_t n, double value[]) {
    Status status = compute(c);
    for (size_t i = 0; i < n; i++) value[i] = ((Tanks *)c)->v[vr[i]];
    return status;
}

static Status set(Instance c, const Reference vr[], size_t n, const double value[]) {
    for (size_t i = 0; i < n; i++) ((Tanks *)c)->v[vr[i]] = value[i];
    return OK;
}

static Status directional(Instance c, const Reference unknown[], size_t n, const Reference known[], size_t m,
                          const double seed[], double found[]) {
    for (size_t i = 0; i < n; i++) {
        found[i] = 0;
        for (size_t j = 0; j < m; j++) found[i] += derivative(c, unknown[i], known[j]) * seed[j];
    }
    return OK;
}

static Status keep(Instance c, void **state) {
    if (*state == NULL) *state = malloc(sizeof(Tanks));
    memcpy(*state, c, sizeof(Tanks));
    return OK;
}

static Status restore(Instance c, void *state) { memcpy(c, state, sizeof(Tanks)); return OK; }

static Status forget(Instance c, void **state) { free(*state); *state = NULL; return OK; }

#if FMI == 2

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    if (strcmp(guid, "two-tanks") != 0) {
        functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", "the guid does not match");
        return NULL;
    }
    return new_tanks();
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real from, fmi2Boolean ends,
                               fmi2Real to) { return fmi2SetTime(c, from); }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    memset(info, 0, sizeof *info);
    info->nextEventTimeDefined = ((Tanks *)c)->v[LAG] < 0;
    info->nextEventTime = -((Tanks *)c)->v[LAG];
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { return rates(c, dx, n); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    return get(c, vr, n, value);
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    return set(c, vr, n, value);
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real seed[], fmi2Real found[]) {
    return directional(c, unknown, n, known, m, seed, found);
}
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) { return keep(c, state); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return restore(c, state); }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) { return forget(c, state); }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real dt, fmi2Boolean final) { return advance(c, dt); }

#else

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    if (strcmp(token, "two-tanks") != 0) {
        log(environment, fmi3Error, "logStatusError", "the token does not match");
        return NULL;
    }
    return new_tanks();
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    return new_tanks();
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance, fmi3Float64 from,
                                       fmi3Boolean ends, fmi3Float64 to) { return fmi3SetTime(c, from); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next) {
    *again = *terminate = *nominals = *values = fmi3False;
    *defined = ((Tanks *)c)->v[LAG] < 0;
    *next = -((Tanks *)c)->v[LAG];
    return fmi3OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) { return rates(c, dx, n); }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t m) {
    return get(c, vr, n, value);
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[], size_t m) {
    return set(c, vr, n, value);
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n,
                                        const fmi3ValueReference known[], size_t m, const fmi3Float64 seed[], size_t k,
                                        fmi3Float64 found[], size_t l) {
    return directional(c, unknown, n, known, m, seed, found);
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return keep(c, state); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return restore(c, state); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) { return forget(c, state); }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 dt, fmi3Boolean final, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    *event = *terminate = *early = fmi3False;
    *last = t + dt;
    return advance(c, dt);
}

#endif
