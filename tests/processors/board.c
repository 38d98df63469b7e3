/* Runs an exported tracker on a microcontroller of QEMU's, or with -DHOST on this machine: the same samples, the same
   answers. Start-up, vectors and semihosting are here, so that no C library is needed.

   Samples (argument, or at SAMPLES in memory): their number, then 16 doubles a call. Written, to `answers` here and
   through the debugger there: of each call 16 words (command, offset, heading error, station, requests of the speed
   control; status, belief, at bound, suspect, state and limit of the speed control, error); on the microcontroller to
   `counts` as well: ticks (8/5 of an instruction) and iterations of the QP of each call, then those of init, of path
   and of follow with the plan, and bytes of stack. */
#include "adaptrack.h"
#include "adaptrack_replay.h"

#include <string.h>
#ifdef QP_ITERATIONS /* the number of the state that says how many there were */
#include "adaptrack_layout.h"
static double iterations(const adaptrack_tracker *tracker) {
    return ((const struct adaptrack_memory *)(const void *)tracker)->state.QP_ITERATIONS;
}
#else
static double iterations(const adaptrack_tracker *tracker) { return tracker ? 0.0 : -1.0; }
#endif

typedef struct { double numbers[9]; int64_t more[7]; } told;
static uint32_t counted(void);
static int drive(adaptrack_tracker *tracker, double *path, const int64_t *given, told *answers, int64_t *counts) {
    const int64_t count = given[0];
    const double *rows = (const double *)(const void *)(given + 1);
    uint32_t begun = counted();
    if (adaptrack_init(tracker, sizeof *tracker, adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE)) return 1;
    counts[2 * count] = counted() - begun, begun = counted();
    if (adaptrack_path(adaptrack_recorded_points, ADAPTRACK_RECORDED_POINTS, 0, NAN, path,
                       ADAPTRACK_RECORDED_PATH_SIZE, 0)) return 2;
    counts[2 * count + 1] = counted() - begun, begun = counted();
    if (follow_recorded(tracker, path)) return 3;
    counts[2 * count + 2] = counted() - begun;
    for (int64_t k = 0; k < count; k++) {
        adaptrack_sample sample;
        adaptrack_answer answer = {0};
        memcpy(&sample, rows + 16 * k, sizeof sample);
        begun = counted();
        const adaptrack_error error = adaptrack_step(tracker, &sample, &answer);
        counts[2 * k] = counted() - begun;
        answers[k] = (told){.more = {0, 0, 0, 0, 0, 0, error}};
        const double changes = iterations(tracker);
        memcpy(counts + 2 * k + 1, &changes, 8);
        answers[k].numbers[0] = answer.command, answers[k].numbers[1] = answer.offset;
        answers[k].numbers[2] = answer.heading_error, answers[k].numbers[3] = answer.station;
        answers[k].more[0] = answer.status, answers[k].more[1] = answer.belief, answers[k].more[2] = answer.at_bound;
        answers[k].more[3] = (int64_t)answer.suspect;
#if ADAPTRACK_SPEED_CONTROL
        answers[k].numbers[4] = answer.acceleration, answers[k].numbers[5] = answer.force;
        answers[k].numbers[6] = answer.hold, answers[k].numbers[7] = answer.target_speed;
        answers[k].numbers[8] = answer.grip_used;
        answers[k].more[4] = answer.speed_state, answers[k].more[5] = answer.limited_by;
#endif
    }
    return 0;
}

#ifdef HOST
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <malloc.h>
#define aligned_alloc(alignment, size) _aligned_malloc(size, alignment)
#endif
static uint32_t counted(void) { return 0; }
int main(int count, char **names) {
    FILE *file = fopen(names[count - 2], "rb");
    int64_t *given = malloc(1 << 24), *counts;
    told *answers;
    /* nothing of it is written before: valgrind sees what is read all the same */
    void *tracker = aligned_alloc(64, (ADAPTRACK_SIZE + 63) / 64 * 64), *path = malloc(ADAPTRACK_RECORDED_PATH_SIZE);
    if (!file || !given || !tracker || !path || !fread(given, 1, 1 << 24, file)) return 1;
    answers = malloc((size_t)given[0] * sizeof *answers), counts = malloc(((size_t)given[0] + 4) * 16);
    if (!answers || !counts || drive(tracker, path, given, answers, counts)) return 2;
    file = fopen(names[count - 1], "wb");
    return !file || fwrite(answers, sizeof *answers, (size_t)given[0], file) != (size_t)given[0] || fclose(file);
}
#else
#define REGISTER(address) (*(volatile uint32_t *)(address))
/* ticks of a timer of 25 MHz; `-icount shift=6` makes an instruction 64 ns: 1.6 ticks */
static uint32_t counted(void) { return 0xffffffffu - REGISTER(TIMER + 4); }
extern uint32_t stack_end[], stack_begin[], data_begin[], data_end[], data_load[], bss_begin[], bss_end[];
static intptr_t semihosting(intptr_t what, const void *with) {
    register intptr_t r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = with;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}
static void keep(const char *name, size_t length, const void *bytes, size_t size) {
    const uintptr_t open[3] = {(uintptr_t)name, 5, length};
    const uintptr_t write[3] = {(uintptr_t)semihosting(1, open), (uintptr_t)bytes, size};
    semihosting(5, write);
    semihosting(2, write);
}
static _Noreturn void leave(int code) {
    const uintptr_t why[2] = {0x20026, (uintptr_t)code};
    semihosting(0x20, why);
    for (;;) {}
}
static void fault(void) { leave(99); }
void begin(void);
__attribute__((section(".vectors"), used)) void (*const vectors[16])(void) = {
    (void (*)(void))stack_end, begin, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault, fault,
    fault, fault,
};
static adaptrack_tracker tracker;
static double path[ADAPTRACK_RECORDED_PATH_SIZE / 8];
static void live(void) {
    const int64_t *given = (const int64_t *)SAMPLES;
    told *answers = (told *)ANSWERS;
    int64_t *counts = (int64_t *)(answers + given[0]);
    uint32_t *deepest = stack_begin;
    int error = drive(&tracker, path, given, answers, counts);
    while (*deepest == 0xa5a5a5a5u) deepest++;
    counts[2 * given[0] + 3] = (int64_t)((uintptr_t)stack_end - (uintptr_t)deepest);
    if (error) leave(error);
    keep("answers", 7, answers, (size_t)given[0] * sizeof *answers);
    keep("counts", 6, counts, (size_t)(2 * given[0] + 4) * 8);
    leave(0);
}
void begin(void) {
    REGISTER(0xe000ed88) |= 0xfu << 20; /* the floating point unit is on */
    __asm__ volatile("dsb; isb");
    for (uint32_t *to = data_begin, *from = data_load; to < data_end;) *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;) *to++ = 0;
    for (uint32_t *to = stack_begin; to < (uint32_t *)__builtin_frame_address(0) - 16;) *to++ = 0xa5a5a5a5u;
    REGISTER(TIMER + 8) = REGISTER(TIMER + 4) = 0xffffffffu;
    REGISTER(TIMER) = 1;
    live();
}
void *memcpy(void *to, const void *from, size_t size) {
    for (size_t i = 0; i < size; i++) ((unsigned char *)to)[i] = ((const unsigned char *)from)[i];
    return to;
}
void *memset(void *to, int value, size_t size) {
    for (size_t i = 0; i < size; i++) ((unsigned char *)to)[i] = (unsigned char)value;
    return to;
}
#endif
