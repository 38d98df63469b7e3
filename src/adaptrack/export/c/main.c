/* Drives the recorded minute: how many of its steps differ from those in Python, byte by byte (any NaN is any NaN). */
#include "adaptrack.h"
#include "adaptrack_replay.h"

#include <stdio.h>
#include <string.h>

static adaptrack_tracker tracker;
static double path[ADAPTRACK_RECORDED_PATH_SIZE / 8];

static uint32_t crc32_of(const unsigned char *bytes, size_t size) {
    uint32_t crc = 0xffffffffu;
    for (size_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        for (int k = 0; k < 8; k++) crc = (crc & 1u) ? 0xedb88320u ^ crc >> 1 : crc >> 1;
    }
    return ~crc;
}

static uint32_t fingerprint(const adaptrack_answer *answer) {
    const double numbers[] = {
@ANSWER_NUMBERS@
#if ADAPTRACK_SPEED_CONTROL
@REQUEST_NUMBERS@
#endif
    };
    unsigned char bytes[sizeof numbers];
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        uint64_t bits = 0x7ff8000000000000u; /* any NaN */
        if (numbers[i] == numbers[i]) memcpy(&bits, numbers + i, sizeof bits);
        for (size_t k = 0; k < 8; k++) bytes[8 * i + k] = (unsigned char)(bits >> (8 * k) & 0xffu);
    }
    return crc32_of(bytes, sizeof bytes);
}

/* Drive the recorded minute under some constants, and count the calls that differ; the last answer. */
adaptrack_error drive_recorded(const void *constants, size_t size, int *differ, adaptrack_answer *answer);

adaptrack_error drive_recorded(const void *constants, size_t size, int *differ, adaptrack_answer *answer) {
    adaptrack_error error = adaptrack_init(&tracker, sizeof tracker, constants, size);
    *differ = 0;
    if (error == ADAPTRACK_OK)
        error = adaptrack_path(adaptrack_recorded_points, ADAPTRACK_RECORDED_POINTS, 0, NAN, path, sizeof path, 0);
    if (error == ADAPTRACK_OK) error = adaptrack_engage(&tracker, 0.0, NAN);
    if (error == ADAPTRACK_OK) error = follow_recorded(&tracker, path);
    for (int k = 0; k < ADAPTRACK_RECORDED_STEPS && error == ADAPTRACK_OK; k++) {
        adaptrack_sample sample;
        memcpy(&sample, adaptrack_recorded[k], sizeof sample);
        error = adaptrack_step(&tracker, &sample, answer);
        if (error == ADAPTRACK_OK && fingerprint(answer) != (uint32_t)adaptrack_recorded[k][sizeof sample / 8u]) ++*differ;
    }
    return error;
}

int main(void) {
    adaptrack_answer answer;
    int differ;
    adaptrack_error error = drive_recorded(adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE, &differ, &answer);
    if (error != ADAPTRACK_OK) {
        printf("%s, error %d of adaptrack_error.h\n", adaptrack_error_name(error), (int)error);
        return 2;
    }
    printf("adaptrack %s\n%d steps, %d differ; the last: command %+.6f rad, offset %+.4f m, at %.1f m\n",
           adaptrack_version(), ADAPTRACK_RECORDED_STEPS, differ, answer.command, answer.offset, answer.station);
    return differ != 0;
}
