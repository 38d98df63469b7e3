/* adaptrack: calls around the compiled kernels. C99, no library, nothing static that is written, no allocation. */
#include "adaptrack.h"

#include "adaptrack_block.h"
#include "adaptrack_parts.h"

/* -- kernels ------------------------------------------------------------------------------------------------------ */
typedef union {
    double number;
    int64_t whole;
} word;
extern int64_t adaptrack_tracker_engage(double wheel_angle, double near, void *tracker);
extern void adaptrack_tracker_follow(double near, void *tracker);
extern int64_t adaptrack_path_words(const double *points, int64_t count, int64_t two, int64_t closed);
extern void adaptrack_path_through(const double *points, int64_t count, int64_t two, int64_t closed, double *memory,
                                   int64_t size, word answers[2]);

/* Place in the record's words; its tracker is at the beginning. */
static uint64_t *record_of(void *tracker) { return (uint64_t *)adaptrack_block_record(tracker); }

static double *numbers_at(const uint64_t *record, size_t place) { return (double *)(uintptr_t)record[place]; }

/* -- a path: a head, then as the kernel makes it: numbers of the road, pieces, where they begin, headings ------- */
typedef struct {
    uint64_t mark;
    uint32_t id; /* CRC-32 of the points */
    uint32_t closed;
    int64_t pieces;
    int64_t headings;
    uint64_t of; /* 0: the road of the only scenario */
    uint64_t reserved[3];
} path_head; /* 64 bytes, a cache line */
typedef char path_head_has_64_bytes[sizeof(path_head) == 64 ? 1 : -1];
static const uint64_t PATH = 0x687461706b726461u; /* "adrkpath" */
enum { NUMBERS = ADAPTRACK_ROAD_NUMBERS, COLUMNS = ADAPTRACK_PIECE_COLUMNS };

static int is_finite(double value) { return value - value == 0.0; }

static double magnitude(double value) { return value < 0.0 ? -value : value; }

static const path_head *head_of(const void *path) {
    const path_head *head = (const path_head *)path;
    return path && (uintptr_t)path % 8u == 0 && head->mark == PATH ? head : 0;
}

static const double *road_of(const path_head *head) { return (const double *)(const void *)(head + 1); }

size_t adaptrack_path_size(const double *points, size_t count, int closed) {
    if (!points || count < 4 || count > ADAPTRACK_MOST_POINTS) return 0;
    return sizeof(path_head) + 8u * (size_t)adaptrack_path_words(points, (int64_t)count, 2, closed != 0);
}

adaptrack_error adaptrack_path(const double *points, size_t count, int closed, void *path, size_t path_size,
                               size_t *flaw) {
    path_head *head = (path_head *)path;
    double *memory;
    word answers[2];
    if (!points || !path || (uintptr_t)path % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    if (flaw) *flaw = count;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) return ADAPTRACK_ARITHMETIC;
    if (count < 4 || count > ADAPTRACK_MOST_POINTS) return ADAPTRACK_BAD_PATH;
    if (path_size < sizeof *head + 8u * NUMBERS) return ADAPTRACK_TOO_SMALL;
    head->mark = 0;
    memory = (double *)(void *)(head + 1);
    adaptrack_path_through(points, (int64_t)count, 2, closed != 0, memory,
                           (int64_t)((path_size - sizeof *head) / 8u), answers);
    if (flaw) *flaw = (size_t)answers[1].whole;
    if (answers[0].whole == ADAPTRACK_PATH_TOO_SMALL) return ADAPTRACK_TOO_SMALL;
    if (answers[0].whole != 0) return ADAPTRACK_BAD_PATH;
    head->closed = closed != 0, head->pieces = answers[1].whole, head->of = 0;
    head->headings = (int64_t)(memory[ADAPTRACK_ROAD_LENGTH] / memory[ADAPTRACK_ROAD_SPACING] + 0.5) + 1;
    for (int i = 0; i < 3; i++) head->reserved[i] = 0;
    head->id = adaptrack_crc32(points, 16u * count) ^ (closed ? 0xffffffffu : 0u);
    head->mark = PATH;
    return ADAPTRACK_OK;
}

double adaptrack_path_length(const void *path) {
    const path_head *head = head_of(path);
    return head ? road_of(head)[ADAPTRACK_ROAD_LENGTH] : NAN;
}

static adaptrack_error check_plan(const adaptrack_plan *plan, const path_head *head) {
    if (!plan || plan->count == 0) return ADAPTRACK_OK;
    if (!plan->s || !plan->speed || plan->count < 2) return ADAPTRACK_BAD_ARGUMENT;
    if (plan->count > ADAPTRACK_MOST_POINTS) return ADAPTRACK_BAD_ARGUMENT;
    for (size_t i = 0; i < plan->count; i++) {
        if (!is_finite(plan->s[i]) || !is_finite(plan->speed[i])) return ADAPTRACK_BAD_ARGUMENT;
        if (!(plan->speed[i] >= 0.0)) return ADAPTRACK_BAD_ARGUMENT;
        if (i > 0 ? !(plan->s[i] > plan->s[i - 1]) : plan->s[i] != 0.0) return ADAPTRACK_BAD_ARGUMENT;
    }
    return magnitude(plan->s[plan->count - 1] - road_of(head)[ADAPTRACK_ROAD_LENGTH]) <= 1.0 ? ADAPTRACK_OK
                                                                                               : ADAPTRACK_BAD_ARGUMENT;
}

static void put_array(uint64_t *record, size_t place, const double *at, int64_t size) {
    record[place] = (uint64_t)(uintptr_t)at;
    record[place + 1] = (uint64_t)size;
}

/* Let the record's road and plan be those of the caller. */
static void put_path(uint64_t *record, const path_head *head, const adaptrack_plan *plan) {
    const double *memory = road_of(head), *start = memory + NUMBERS + COLUMNS * head->pieces;
    record[ADAPTRACK_PATH_OF] = (uint64_t)(uintptr_t)&head->of, record[ADAPTRACK_PATH_OF + 1] = 1;
    record[ADAPTRACK_PATH_NUMBERS] = (uint64_t)(uintptr_t)memory;
    record[ADAPTRACK_PATH_NUMBERS + 1] = 1, record[ADAPTRACK_PATH_NUMBERS + 2] = NUMBERS;
    put_array(record, ADAPTRACK_PATH_START, start, head->pieces + 1);
    record[ADAPTRACK_PATH_PIECES] = (uint64_t)(uintptr_t)(memory + NUMBERS);
    record[ADAPTRACK_PATH_PIECES + 1] = (uint64_t)head->pieces, record[ADAPTRACK_PATH_PIECES + 2] = COLUMNS;
    put_array(record, ADAPTRACK_PATH_HEADINGS, start + head->pieces + 1, head->headings);
    if (plan && plan->count > 0) {
        put_array(record, ADAPTRACK_PLAN_S, plan->s, (int64_t)plan->count);
        put_array(record, ADAPTRACK_PLAN_SPEED, plan->speed, (int64_t)plan->count);
    } else {
        put_array(record, ADAPTRACK_PLAN_S, 0, 0);
        put_array(record, ADAPTRACK_PLAN_SPEED, 0, 0);
    }
}

/* By which a path and its plan are known again. */
static uint32_t path_id(const path_head *head, const adaptrack_plan *plan) {
    uint32_t parts[3] = {head->id, 0, 0};
    if (plan && plan->count > 0) {
        parts[1] = adaptrack_crc32(plan->s, 8u * plan->count);
        parts[2] = adaptrack_crc32(plan->speed, 8u * plan->count);
    }
    return adaptrack_crc32(parts, sizeof parts) | 1u;
}

/* -- the tracker -------------------------------------------------------------------------------------------------- */
size_t adaptrack_size(const void *constants, size_t size) { return adaptrack_block_memory(constants, size); }

const char *adaptrack_version(void) { return ADAPTRACK_VERSION; }

#define NAME(error) \
    case error: return #error
const char *adaptrack_error_name(adaptrack_error error) {
    switch (error) {
        NAME(ADAPTRACK_OK);
        NAME(ADAPTRACK_BAD_ARGUMENT);
        NAME(ADAPTRACK_TOO_SMALL);
        NAME(ADAPTRACK_NOT_READY);
        NAME(ADAPTRACK_BUSY);
        NAME(ADAPTRACK_DAMAGED);
        NAME(ADAPTRACK_OTHER_VERSION);
        NAME(ADAPTRACK_OTHER_KIND);
        NAME(ADAPTRACK_OTHER_SIZES);
        NAME(ADAPTRACK_OTHER_CONSTANTS);
        NAME(ADAPTRACK_OTHER_PATH);
        NAME(ADAPTRACK_ARITHMETIC);
        NAME(ADAPTRACK_BAD_PATH);
        NAME(ADAPTRACK_OUT_OF_ORDER);
    }
    return "an unknown error";
}

adaptrack_error adaptrack_init(void *tracker, size_t tracker_size, const void *constants, size_t size) {
    return adaptrack_block_lay(&adaptrack_parts, tracker, tracker_size, constants, size);
}

adaptrack_error adaptrack_load(void *tracker, const void *constants, size_t size) {
    uint64_t path[ADAPTRACK_PATH_END - ADAPTRACK_PATH_OF];
    adaptrack_error error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    for (size_t i = 0; i < sizeof path / 8u; i++) path[i] = record_of(tracker)[ADAPTRACK_PATH_OF + i];
    error = adaptrack_block_renew(&adaptrack_parts, tracker, constants, size);
    for (size_t i = 0; i < sizeof path / 8u; i++) record_of(tracker)[ADAPTRACK_PATH_OF + i] = path[i];
    adaptrack_block_give(tracker);
    return error;
}

adaptrack_error adaptrack_engage(void *tracker, double wheel_angle, double near) {
    adaptrack_error error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) error = ADAPTRACK_ARITHMETIC;
    else if (adaptrack_tracker_engage(wheel_angle, near, record_of(tracker)) == 0) error = ADAPTRACK_BAD_ARGUMENT;
    adaptrack_block_give(tracker);
    return error;
}

adaptrack_error adaptrack_follow(void *tracker, const void *path, double near, const adaptrack_plan *plan) {
    const path_head *head = head_of(path);
    adaptrack_error error;
    if (!head) return ADAPTRACK_BAD_PATH;
    error = check_plan(plan, head);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) {
        error = ADAPTRACK_ARITHMETIC;
    } else {
        put_path(record_of(tracker), head, plan);
        adaptrack_tracker_follow(near, record_of(tracker));
        ((adaptrack_head *)tracker)->path = path_id(head, plan);
        ((adaptrack_head *)tracker)->points = head->id;
    }
    adaptrack_block_give(tracker);
    return error;
}

/* A number that stands for a status or a state, 0 where it is none. */
static int small(double value) { return value > -1000.0 && value < 1000.0 ? (int)value : 0; }

static void read_answer(const double *tracked, adaptrack_answer *answer) {
    double suspect;
    answer->command = tracked[ADAPTRACK_TRACKED_COMMAND];
    answer->offset = tracked[ADAPTRACK_TRACKED_OFFSET];
    answer->heading_error = tracked[ADAPTRACK_TRACKED_HEADING_ERROR];
    answer->station = tracked[ADAPTRACK_TRACKED_STATION];
    answer->status = (adaptrack_status)small(tracked[ADAPTRACK_TRACKED_STATUS]);
    answer->belief = small(tracked[ADAPTRACK_TRACKED_BELIEF_STATE]);
    answer->at_bound = small(tracked[ADAPTRACK_TRACKED_BELIEF_AT_BOUND]);
    suspect = tracked[ADAPTRACK_TRACKED_SUSPECT];
    answer->suspect = suspect >= 1.0 && suspect < 9e15 ? (uint64_t)suspect : 0u;
    answer->first_top_speed = tracked[ADAPTRACK_TRACKED_FIRST_TOP_SPEED];
}

/* ADAPTRACK_BAD_PATH where the path that is followed has been overwritten. */
static adaptrack_error check_path(void *tracker) {
    const adaptrack_head *own = (const adaptrack_head *)tracker;
    const path_head *head;
    if (own->path == 0) return ADAPTRACK_OUT_OF_ORDER;
    head = (const path_head *)(uintptr_t)record_of(tracker)[ADAPTRACK_PATH_NUMBERS] - 1;
    return head->mark == PATH && head->id == own->points ? ADAPTRACK_OK : ADAPTRACK_BAD_PATH;
}

adaptrack_error adaptrack_step(void *tracker, const adaptrack_sample *sample, adaptrack_answer *answer) {
    adaptrack_error error;
    double *given;
    if (!sample || !answer) return ADAPTRACK_BAD_ARGUMENT;
    error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_arithmetic();
    if (error == ADAPTRACK_OK) error = check_path(tracker);
    if (error == ADAPTRACK_OK) {
        given = numbers_at(record_of(tracker), ADAPTRACK_SAMPLE_AT);
        given[ADAPTRACK_SAMPLE_T] = sample->t, given[ADAPTRACK_SAMPLE_NOW] = sample->now;
        given[ADAPTRACK_SAMPLE_X] = sample->x, given[ADAPTRACK_SAMPLE_Y] = sample->y;
        given[ADAPTRACK_SAMPLE_YAW] = sample->yaw, given[ADAPTRACK_SAMPLE_SPEED] = sample->speed;
        given[ADAPTRACK_SAMPLE_YAW_RATE] = sample->yaw_rate, given[ADAPTRACK_SAMPLE_VY] = sample->lateral_velocity;
        given[ADAPTRACK_SAMPLE_LATERAL_ACCELERATION] = sample->lateral_acceleration;
        given[ADAPTRACK_SAMPLE_WHEEL_ANGLE] = sample->wheel_angle;
        given[ADAPTRACK_SAMPLE_FRICTION] = sample->friction, given[ADAPTRACK_SAMPLE_WIND] = sample->wind;
        given[ADAPTRACK_SAMPLE_MOTION_T] = sample->motion_time;
        adaptrack_parts_step(record_of(tracker));
        read_answer(numbers_at(record_of(tracker), ADAPTRACK_TRACKED_AT), answer);
    }
    adaptrack_block_give(tracker);
    return error;
}

/* -- the state ---------------------------------------------------------------------------------------------------- */
size_t adaptrack_state_size(const void *tracker) { return adaptrack_block_state_size(tracker); }

adaptrack_error adaptrack_save(void *tracker, void *state, size_t size) {
    adaptrack_error error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_block_save(&adaptrack_parts, tracker, state, size);
    adaptrack_block_give(tracker);
    return error;
}

adaptrack_error adaptrack_restore(void *tracker, const void *state, size_t size) {
    adaptrack_error error = adaptrack_block_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_block_restore(&adaptrack_parts, tracker, state, size);
    adaptrack_block_give(tracker);
    return error;
}
