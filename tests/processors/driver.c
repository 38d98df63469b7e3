/* Runs an image (see image.py): driver IMAGE ANSWERS. FUNCTIONS, in functions.h, are those that the image links to. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "functions.h"
#ifdef _WIN32
#include <malloc.h>
#define aligned_alloc(alignment, size) _aligned_malloc(size, alignment)
#endif

extern void adaptrack_elementary_values(int64_t, void *, int64_t, int64_t, void *, int64_t);
extern void adaptrack_mpc_step(void *);
extern void adaptrack_begin_runs(int64_t, void *);
extern int64_t adaptrack_roll_on(int64_t, int64_t, void *);
extern int64_t adaptrack_informed_numbers(void *, void *);
extern int64_t adaptrack_lqr_parameters(void *, void *, void *, int64_t, void *, int64_t);

enum { GAINS = 6820 }; /* numbers of an LQR, `core.synthesis.laws.LQR` */

int main(int count, char **names) {
    FILE *given = fopen(names[1], "rb"), *answers = fopen(names[2], "wb");
    int64_t head[4];
    if (count != 3 || !given || !answers || fread(head, 8, 4, given) != 4) return 1;
    size_t rest = 2 * head[1] + 2 * head[2] + 5 * head[3];
    int64_t *memory = aligned_alloc(64, 8 * head[0] + 64), *at = malloc(8 * rest);
    if (fread(memory, 8, head[0], given) != (size_t)head[0] || fread(at, 8, rest, given) != rest) return 1;
    for (int64_t i = 0; i < head[1]; i++, at += 2) memory[at[0]] = (int64_t)(uintptr_t)(memory + at[1]);
    for (int64_t i = 0; i < head[2]; i++, at += 2) memory[at[0]] = (int64_t)(uintptr_t)FUNCTIONS[at[1]];
    for (int64_t i = 0; i < head[3]; i++, at += 5) {
        switch (at[0]) {
        case 0: adaptrack_elementary_values(at[1], memory + at[2], 3, at[3], memory + at[4], at[3]); break;
        case 1: memmove(memory + at[2], memory + at[1], 8 * at[3]); break;
        case 2: adaptrack_mpc_step(memory + at[1]); break;
        case 3: adaptrack_begin_runs(at[1], memory + at[2]); break;
        case 4: adaptrack_roll_on(at[1], at[2], memory + at[3]); break;
        case 6:
            adaptrack_informed_numbers(memory + at[1], memory + at[2]);
            break;
        case 7:
            adaptrack_lqr_parameters(memory + at[1], memory + at[2], memory + at[3], 4, memory + at[4], GAINS);
            break;
        case 5: fwrite(memory + at[1], 8, at[2], answers); break;
        default: return 1;
        }
    }
    return fclose(answers) != 0;
}
