/* Calls of an exported tracker: replay SAMPLES ANSWERS, files of doubles: 13 a call, then 5 an answer (see adaptrack.h).
   POINTS, the path's, and the plan come first: counts of both as doubles, x and y of each point, s and speed of the plan. */
#include "adaptrack.h"
#include <stdio.h>
#include <stdlib.h>

int main(int count, char **names) {
    FILE *given = fopen(names[1], "rb"), *answers = fopen(names[2], "wb");
    static adaptrack_tracker tracker;
    double counts[2], row[13], found[5];
    if (count != 3 || !given || !answers || fread(counts, 8, 2, given) != 2) return 1;
    size_t points = (size_t)counts[0], plan = (size_t)counts[1];
    double *numbers = malloc(16 * (points + plan));
    if (fread(numbers, 8, 2 * (points + plan), given) != 2 * (points + plan)) return 1;
    size_t size = adaptrack_path_size(numbers, points, 0);
    void *path = malloc(size);
    adaptrack_plan speeds = {numbers + 2 * points, numbers + 2 * points + plan, plan};
    if (adaptrack_init(&tracker, sizeof tracker, adaptrack_constants, ADAPTRACK_CONSTANTS_SIZE)) return 2;
    if (adaptrack_path(numbers, points, 0, NAN, path, size, 0) || adaptrack_follow(&tracker, path, NAN, &speeds)) return 3;
    while (fread(row, 8, 13, given) == 13) {
        adaptrack_sample sample = {row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9],
                                   row[10], row[11], row[12]};
        adaptrack_answer answer;
        if (adaptrack_step(&tracker, &sample, &answer)) return 4;
        found[0] = answer.command, found[1] = answer.status, found[2] = answer.offset;
        found[3] = answer.heading_error, found[4] = answer.station;
        fwrite(found, 8, 5, answers);
    }
    return fclose(answers) != 0;
}
