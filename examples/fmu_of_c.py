"""An FMU of a few equations in C, made by the machine's compiler: FMI 2.0 or 3.0, model exchange or co-simulation.

What is written is ``rates``, the states' rates of values; everything around it that towline asks of an FMU stands here.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

AROUND = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
typedef struct { double v[VALUES]; double t; } Model;   /* the states first */
static const double START[VALUES] = {STARTS};
static void rates(const Model *m, const double *x, double *d);
static void step(Model *m, double h) {
    int n = 4;
    h /= n;
    for (int i = 0; i < n; ++i) {
        double x[STATES], k1[STATES], k2[STATES], k3[STATES], k4[STATES];
        rates(m, m->v, k1);
        for (int j = 0; j < STATES; ++j) x[j] = m->v[j] + 0.5 * h * k1[j];
        rates(m, x, k2);
        for (int j = 0; j < STATES; ++j) x[j] = m->v[j] + 0.5 * h * k2[j];
        rates(m, x, k3);
        for (int j = 0; j < STATES; ++j) x[j] = m->v[j] + h * k3[j];
        rates(m, x, k4);
        for (int j = 0; j < STATES; ++j) m->v[j] += h / 6 * (k1[j] + 2 * k2[j] + 2 * k3[j] + k4[j]);
    }
    m->t += n * h;
}
static void *fresh(void) {
    Model *m = calloc(1, sizeof(Model));
    memcpy(m->v, START, sizeof START);
    return m;
}
static int reset(void *c) { memcpy(((Model *)c)->v, START, sizeof START); ((Model *)c)->t = 0; return 0; }
static int put(void *c, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; ++i) { if (r[i] >= VALUES) return 3; ((Model *)c)->v[r[i]] = v[i]; }
    return 0;
}
static int take(void *c, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; ++i) { if (r[i] >= VALUES) return 3; v[i] = ((Model *)c)->v[r[i]]; }
    return 0;
}
/* what the standard has beside, and nothing here needs */
#define NONE(name) int name(void) { return 3; }
#if FMI == 2
typedef struct { int need, end, nominals, values, defined; double next; } Event;
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int k, const char *g, const char *r, const void *f, int v, int l) { return fresh(); }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int d, double tol, double t, int sd, double s) { ((Model *)c)->t = t; return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { return 0; }
int fmi2Terminate(void *c) { return 0; }
int fmi2Reset(void *c) { return reset(c); }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) { return put(c, r, n, v); }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) { return take(c, r, n, v); }
int fmi2NewDiscreteStates(void *c, Event *e) { memset(e, 0, sizeof *e); return 0; }
int fmi2EnterContinuousTimeMode(void *c) { return 0; }
int fmi2SetTime(void *c, double t) { ((Model *)c)->t = t; return 0; }
int fmi2SetContinuousStates(void *c, const double *x, size_t n) { memcpy(((Model *)c)->v, x, n * sizeof *x); return 0; }
int fmi2GetDerivatives(void *c, double *d, size_t n) { rates(c, ((Model *)c)->v, d); return 0; }
int fmi2DoStep(void *c, double t, double h, int p) { step(c, h); return 0; }
NONE(fmi2CancelStep) NONE(fmi2CompletedIntegratorStep) NONE(fmi2DeSerializeFMUstate) NONE(fmi2EnterEventMode)
NONE(fmi2FreeFMUstate) NONE(fmi2GetBoolean) NONE(fmi2GetBooleanStatus) NONE(fmi2GetContinuousStates)
NONE(fmi2GetDirectionalDerivative) NONE(fmi2GetEventIndicators) NONE(fmi2GetFMUstate) NONE(fmi2GetInteger)
NONE(fmi2GetIntegerStatus) NONE(fmi2GetNominalsOfContinuousStates) NONE(fmi2GetRealOutputDerivatives)
NONE(fmi2GetRealStatus) NONE(fmi2GetStatus) NONE(fmi2GetString) NONE(fmi2GetStringStatus) NONE(fmi2SerializeFMUstate)
NONE(fmi2SerializedFMUstateSize) NONE(fmi2SetBoolean) NONE(fmi2SetDebugLogging) NONE(fmi2SetFMUstate) NONE(fmi2SetInteger)
NONE(fmi2SetRealInputDerivatives) NONE(fmi2SetString)
#else
#include <stdbool.h>
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateModelExchange(const char *n, const char *g, const char *r, bool v, bool l, void *e, void *f) {
    return fresh();
}
void *fmi3InstantiateCoSimulation(const char *n, const char *g, const char *r, bool v, bool l, bool ev, bool ea, const unsigned *q,
                                  size_t nq, void *e, void *f, void *i) { return fresh(); }
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(void *c, bool d, double tol, double t, bool sd, double s) { ((Model *)c)->t = t; return 0; }
int fmi3ExitInitializationMode(void *c) { return 0; }
int fmi3Terminate(void *c) { return 0; }
int fmi3Reset(void *c) { return reset(c); }
int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t m) { return put(c, r, n, v); }
int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t m) { return take(c, r, n, v); }
int fmi3UpdateDiscreteStates(void *c, bool *a, bool *b, bool *d, bool *e, bool *f, double *t) {
    *a = *b = *d = *e = *f = false;
    return 0;
}
int fmi3EnterContinuousTimeMode(void *c) { return 0; }
int fmi3SetTime(void *c, double t) { ((Model *)c)->t = t; return 0; }
int fmi3SetContinuousStates(void *c, const double *x, size_t n) { memcpy(((Model *)c)->v, x, n * sizeof *x); return 0; }
int fmi3GetContinuousStateDerivatives(void *c, double *d, size_t n) { rates(c, ((Model *)c)->v, d); return 0; }
int fmi3DoStep(void *c, double t, double h, bool p, bool *a, bool *b, bool *e, double *last) {
    step(c, h);
    *a = *b = *e = false;
    *last = t + h;
    return 0;
}
NONE(fmi3ActivateModelPartition) NONE(fmi3CompletedIntegratorStep) NONE(fmi3DeserializeFMUState)
NONE(fmi3EnterConfigurationMode) NONE(fmi3EnterEventMode) NONE(fmi3EnterStepMode) NONE(fmi3EvaluateDiscreteStates)
NONE(fmi3ExitConfigurationMode) NONE(fmi3FreeFMUState) NONE(fmi3GetAdjointDerivative) NONE(fmi3GetBinary)
NONE(fmi3GetBoolean) NONE(fmi3GetClock) NONE(fmi3GetContinuousStates) NONE(fmi3GetDirectionalDerivative)
NONE(fmi3GetEventIndicators) NONE(fmi3GetFMUState) NONE(fmi3GetFloat32) NONE(fmi3GetInt16) NONE(fmi3GetInt32)
NONE(fmi3GetInt64) NONE(fmi3GetInt8) NONE(fmi3GetIntervalDecimal) NONE(fmi3GetIntervalFraction)
NONE(fmi3GetNominalsOfContinuousStates) NONE(fmi3GetNumberOfContinuousStates) NONE(fmi3GetNumberOfEventIndicators)
NONE(fmi3GetNumberOfVariableDependencies) NONE(fmi3GetOutputDerivatives) NONE(fmi3GetShiftDecimal)
NONE(fmi3GetShiftFraction) NONE(fmi3GetString) NONE(fmi3GetUInt16) NONE(fmi3GetUInt32) NONE(fmi3GetUInt64)
NONE(fmi3GetUInt8) NONE(fmi3GetVariableDependencies) NONE(fmi3InstantiateScheduledExecution) NONE(fmi3SerializeFMUState)
NONE(fmi3SerializedFMUStateSize) NONE(fmi3SetBinary) NONE(fmi3SetBoolean) NONE(fmi3SetClock) NONE(fmi3SetDebugLogging)
NONE(fmi3SetFMUState) NONE(fmi3SetFloat32) NONE(fmi3SetInt16) NONE(fmi3SetInt32) NONE(fmi3SetInt64) NONE(fmi3SetInt8)
NONE(fmi3SetIntervalDecimal) NONE(fmi3SetIntervalFraction) NONE(fmi3SetShiftDecimal) NONE(fmi3SetShiftFraction)
NONE(fmi3SetString) NONE(fmi3SetUInt16) NONE(fmi3SetUInt32) NONE(fmi3SetUInt64) NONE(fmi3SetUInt8)
#endif
"""
"""All but the equations."""


@dataclass(frozen=True)
class Variable:
    """A line of modelDescription.xml.

    Attributes
    ----------
    name, unit : of it
    start : value
    causality : "output", "local", "parameter" or "input"
    variability : "continuous", "fixed" or "tunable"
    least : bound, or None
    """

    name: str
    unit: str
    start: float
    causality: str
    variability: str = "continuous"
    least: float | None = None


def description(name: str, variables: Sequence[Variable], states: int, version: int, kind: str) -> str:
    """modelDescription.xml.

    Parameters
    ----------
    name : of the model
    variables : the states first
    states : how many
    version : 2 or 3
    kind : "exchange" or "co-simulation"
    """
    rows = []
    for reference, one in enumerate(variables):
        start = repr(one.start).removesuffix(".0")
        initially = "" if one.causality == "input" else 'initial="exact" '
        bounds = "" if one.least is None else f'min="{one.least:g}"'
        head = f'name="{one.name}" valueReference="{reference}" causality="{one.causality}" '
        head += f'variability="{one.variability}" {initially}'
        if version == 2:
            inner = f'<Real unit="{one.unit}" start="{start}" {bounds}/>'
            rows.append(f"<ScalarVariable {head}>{inner}</ScalarVariable>")
        else:
            rows.append(f'<Float64 {head} unit="{one.unit}" start="{start}" {bounds}/>')
    count = len(variables)
    for state in range(states):
        head = f'name="der({variables[state].name})" valueReference="{count + state}" causality="local" '
        head += 'variability="continuous" initial="calculated"'
        if version == 2:
            rows.append(f'<ScalarVariable {head}><Real derivative="{state + 1}"/></ScalarVariable>')
        else:
            rows.append(f'<Float64 {head} derivative="{state}"/>')
    element = "ModelExchange" if kind == "exchange" else "CoSimulation"
    steps = "" if kind == "exchange" else ' canHandleVariableCommunicationStepSize="true"'
    interface = f'<{element} modelIdentifier="{name}"{steps}/>'
    outputs = [k for k, one in enumerate(variables) if one.causality == "output"]
    if version == 2:
        told = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
        rates = "".join(f'<Unknown index="{count + k + 1}"/>' for k in range(states))
        structure = f"<Outputs>{told}</Outputs><Derivatives>{rates}</Derivatives>"
        head = f'fmiVersion="2.0" modelName="{name}" guid="{_token(name)}" numberOfEventIndicators="0"'
    else:
        structure = "".join(f'<Output valueReference="{k}"/>' for k in outputs)
        structure += "".join(f'<ContinuousStateDerivative valueReference="{count + k}"/>' for k in range(states))
        head = f'fmiVersion="3.0" modelName="{name}" instantiationToken="{_token(name)}"'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription {head}>{interface}\n<ModelVariables>\n'
        + "\n".join(rows)
        + f"\n</ModelVariables>\n<ModelStructure>{structure}</ModelStructure>\n</fmiModelDescription>\n"
    )


def _token(name: str) -> str:
    return f"{{towline-{name}-1}}"


def make(
    path: Path,
    name: str,
    equations: str,
    variables: Sequence[Variable],
    states: int,
    version: int = 2,
    kind: str = "exchange",
    platform: str = "",
) -> Path:
    """Compile and pack.

    Parameters
    ----------
    path : of the FMU
    name : of the model
    equations : C code of ``rates``
    variables : the states first; ``m->v`` has them in this order
    states : how many
    version : 2 or 3
    kind : "exchange" or "co-simulation"
    platform : folder of its binary; empty: this machine's

    Returns
    -------
    path : the same
    """
    import fmpy

    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise SystemExit("no C compiler (gcc, cc) is there")
    here = fmpy.platform if version == 2 else fmpy.platform_tuple
    starts = ", ".join(repr(one.start) for one in variables)
    sizes = f"#define VALUES {len(variables)}\n#define STATES {states}\n"
    with tempfile.TemporaryDirectory() as folder:
        source, built = Path(folder) / f"{name}.c", Path(folder) / f"{name}{fmpy.sharedLibraryExtension}"
        source.write_text(sizes + AROUND.replace("{STARTS}", f"{{{starts}}}") + equations, encoding="utf-8")
        subprocess.run(
            [compiler, "-O2", "-w", "-shared", "-fPIC", f"-DFMI={version}", str(source), "-o", str(built), "-lm"],
            check=True,
        )
        with zipfile.ZipFile(path, "w") as pack:
            pack.writestr("modelDescription.xml", description(name, variables, states, version, kind))
            pack.write(built, f"binaries/{platform or here}/{built.name}")
    return path


__all__ = ["Variable", "description", "make"]
