/* Drives an FMU 3.0 without a master: fmu_driver LIBRARY RESOURCES TOKEN PERIOD STEPS COMMAND, writes the outputs.
   COMMAND: reference of the steering command; the others keep their start values. Outputs are all other references. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(name) (void *)LoadLibraryA(name)
#define FIND(library, name) (void *)GetProcAddress((HMODULE)library, name)
#else
#include <dlfcn.h>
#define OPEN(name) dlopen(name, RTLD_NOW | RTLD_LOCAL)
#define FIND dlsym
#endif

typedef void *(*instantiate)(const char *, const char *, const char *, bool, bool, bool, bool, const uint32_t *, size_t,
                             void *, void (*)(void *, int, const char *, const char *), void *);
typedef int (*enter)(void *, bool, double, double, bool, double);
typedef int (*call)(void *);
typedef int (*get)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*set)(void *, const uint32_t *, size_t, const double *, size_t);
typedef int (*step)(void *, double, double, bool, bool *, bool *, bool *, double *);

static void say(void *environment, int status, const char *category, const char *text) {
    fprintf(stderr, "%d %s: %s\n", status, category, text);
}

int main(int count, char **given) {
    void *library = count == 7 ? OPEN(given[1]) : NULL;
    if (!library) return 1;
    double period = atof(given[4]), command, value, last;
    long steps = atol(given[5]);
    uint32_t reference = (uint32_t)atol(given[6]);
    bool a, b, c;
    void *one = ((instantiate)FIND(library, "fmi3InstantiateCoSimulation"))(
        "one", given[3], given[2], false, false, false, false, NULL, 0, NULL, say, NULL);
    if (!one || ((enter)FIND(library, "fmi3EnterInitializationMode"))(one, false, 0.0, 0.0, false, 0.0)) return 2;
    if (((call)FIND(library, "fmi3ExitInitializationMode"))(one)) return 3;
    set put = (set)FIND(library, "fmi3SetFloat64");
    get take = (get)FIND(library, "fmi3GetFloat64");
    step go = (step)FIND(library, "fmi3DoStep");
    clock_t begun = clock();
    for (long k = 0; k < steps; k++) {
        command = (double)(k % 41 - 20) / 512.0;
        if (put(one, &reference, 1, &command, 1) || go(one, (double)k * period, period, true, &a, &b, &c, &last)) return 4;
    }
    fprintf(stderr, "%.3g us a step\n", 1e6 * (double)(clock() - begun) / CLOCKS_PER_SEC / (double)steps);
    for (uint32_t i = reference + 15; i < reference + 38; i++) { /* the outputs of a car that are numbers */
        uint64_t bits;
        if (take(one, &i, 1, &value, 1)) return 5;
        memcpy(&bits, &value, 8);
        if (value != value) bits = 0;
        printf("%016llx\n", (unsigned long long)bits);
    }
    ((void (*)(void *))FIND(library, "fmi3FreeInstance"))(one);
    return 0;
}
