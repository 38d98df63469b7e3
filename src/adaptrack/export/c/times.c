/* Times steps of the recorded drive, over and over, in processor time: p50, p99, the worst; and the worst of the
   drive's steps where each counts with the least of its repeats, as on a processor that does nothing else. POSIX;
   usage: times [STEPS] */
#define _POSIX_C_SOURCE 199309L
#include "adaptrack.h"
#include "adaptrack_replay.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static adaptrack_tracker tracker;
static double path[ADAPTRACK_RECORDED_PATH_SIZE / 8];

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

int main(int count, char **words) {
    const long steps = count > 1 ? strtol(words[1], 0, 10) : 1000000;
    float *times = malloc((size_t)steps * sizeof *times); /* of this program, not of the library */
    adaptrack_answer answer;
    float undisturbed = 0.0f;
    double begun, mean = 0.0;
    if (!times || steps < 100) return 1;
    begun = now();
    if (adaptrack_path(adaptrack_recorded_points, ADAPTRACK_RECORDED_POINTS, 0, NAN, path, sizeof path, 0) != ADAPTRACK_OK)
        return 1;
    printf("a path through %d points: %.0f us, %d kB\n", ADAPTRACK_RECORDED_POINTS, 1e6 * (now() - begun),
           (int)(sizeof path / 1000));
    if (adaptrack_init(&tracker, sizeof tracker, adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE) != ADAPTRACK_OK)
        return 1;
    for (long i = 0; i < steps; i++) {
        adaptrack_sample sample;
        if (i % ADAPTRACK_RECORDED_DRIVEN == 0) {
            if (adaptrack_engage(&tracker, 0.0, NAN) != ADAPTRACK_OK) return 1;
            if (follow_recorded(&tracker, path) != ADAPTRACK_OK) return 1;
        }
        memcpy(&sample, adaptrack_recorded[i % ADAPTRACK_RECORDED_DRIVEN], sizeof sample);
        begun = now();
        if (adaptrack_step(&tracker, &sample, &answer) != ADAPTRACK_OK) return 1;
        times[i] = (float)(now() - begun);
        mean += times[i] / (double)steps;
    }
    for (int k = 0; k < ADAPTRACK_RECORDED_DRIVEN; k++) {
        float least = 1.0f;
        for (long i = k; i < steps; i += ADAPTRACK_RECORDED_DRIVEN)
            if (times[i] < least) least = times[i];
        if (least < 1.0f && least > undisturbed) undisturbed = least;
    }
    qsort(times, (size_t)steps, sizeof *times, ascending);
    printf("%ld steps: mean %.2f us, p50 %.2f, p99 %.2f, p99.9 %.2f, worst %.1f; undisturbed at most %.1f\n",
           steps, 1e6 * mean,
           1e6 * (double)times[steps / 2], 1e6 * (double)times[steps - steps / 100],
           1e6 * (double)times[steps - steps / 1000], 1e6 * (double)times[steps - 1], 1e6 * (double)undisturbed);
    free(times);
    return 0;
}
