/* adaptrack: calls around the compiled kernels. C99, no library, nothing static that is written, no allocation. */
#include "adaptrack.h"

#include "adaptrack_layout.h"

/* -- kernels ------------------------------------------------------------------------------------------------------ */
typedef struct tracker_step_Tracking tracking;
typedef struct adaptrack_memory memory_of_tracker;
extern void adaptrack_tracker_step(tracking *);
extern int64_t adaptrack_tracker_engage(double wheel_angle, double near, struct tracker_records_TrackerRecord *);
extern void adaptrack_tracker_follow(double near, struct tracker_records_TrackerRecord *);
extern void adaptrack_tracker_predict(tracking *, double *points, int64_t size, adaptrack_word answers[2]);
extern int64_t adaptrack_path_words(const double *points, int64_t count, int64_t two, int64_t closed);
extern void adaptrack_path_through(const double *points, int64_t count, int64_t two, int64_t closed, double noise,
                                   double *memory, int64_t size, adaptrack_word answers[2]);
#if ADAPTRACK_SPEED_CONTROL
typedef struct tracker_longitudinal_Longitudinal longitudinal;
extern void adaptrack_longitudinal_follow(longitudinal *);
extern void adaptrack_longitudinal_begin(longitudinal *);
extern void adaptrack_longitudinal_release(longitudinal *);
extern void adaptrack_longitudinal_acknowledge(longitudinal *);
extern int64_t adaptrack_speed_path_words(double length, int64_t closed, int64_t stops);
extern void adaptrack_write_speed_path(struct speed_path_PlanArrays *, double *memory, int64_t size,
                                       adaptrack_word answers[2]);
extern int64_t adaptrack_horizon_cells(double top_speed, double braking, double spacing);
#endif
#if ADAPTRACK_PLANNER
typedef struct tracker_followed_Followed followed;
extern void adaptrack_join_trajectory(const double *points, int64_t count, int64_t seven,
                                      struct tracker_planner_Arrival *, const double *fallback,
                                      int64_t fallback_count, int64_t fallback_seven, int64_t fallback_urgent,
                                      tracking *, followed *, adaptrack_word answers[3]);
extern void adaptrack_trajectory_step(tracking *, followed *);
extern void adaptrack_trajectory_predict(tracking *, followed *, double *points, int64_t size,
                                         adaptrack_word answers[2]);
extern void adaptrack_leave_planner(struct tracker_records_TrackerRecord *);
#endif

#if ADAPTRACK_PLANS
extern void adaptrack_mpc_prepare(struct controllers_mpc_Mpc *);
#endif

static tracking *record_of(void *tracker) { return &((memory_of_tracker *)tracker)->record; }

/* Numbers of the caller, which the kernels only read. */
static struct vector vector_at(const double *numbers, int64_t count) {
    return vector_of((double *)(uintptr_t)numbers, count);
}

static struct matrix matrix_at(const double *numbers, int64_t rows, int64_t columns) {
    return matrix_of((double *)(uintptr_t)numbers, rows, columns);
}

/* -- a path: a head, then as the kernel makes it: numbers of the road, pieces, where they begin, headings ------- */
typedef struct {
    uint64_t mark;
    uint32_t id; /* CRC-32 of points and noise */
    uint32_t closed;
    int64_t pieces;
    int64_t headings;
    int64_t of; /* 0: the road of the only scenario */
    uint64_t reserved[3];
} path_head; /* 64 bytes, a cache line */
typedef char path_head_has_64_bytes[sizeof(path_head) == 64 ? 1 : -1];
static const uint64_t PATH = 0x687461706b726461u; /* "adrkpath" */
enum { NUMBERS = ADAPTRACK_ROAD_NUMBERS, COLUMNS = ADAPTRACK_PIECE_COLUMNS };

static const path_head *head_of(const void *path) {
    const path_head *head = (const path_head *)path;
    return path && (uintptr_t)path % 8u == 0 && head->mark == PATH ? head : 0;
}

static const double *road_of(const path_head *head) { return (const double *)(const void *)(head + 1); }

size_t adaptrack_path_size(const double *points, size_t count, int closed) {
    if (!points || count < 4 || count > ADAPTRACK_MOST_POINTS) return 0;
    return sizeof(path_head) + 8u * (size_t)adaptrack_path_words(points, (int64_t)count, 2, closed != 0);
}

adaptrack_error adaptrack_path(const double *points, size_t count, int closed, double noise, void *path,
                               size_t path_size, size_t *flaw) {
    path_head *head = (path_head *)path;
    double *memory;
    adaptrack_word answers[2];
    if (!points || !path || (uintptr_t)path % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    if (flaw) *flaw = count;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) return ADAPTRACK_ARITHMETIC;
    if (count < 4 || count > ADAPTRACK_MOST_POINTS) return ADAPTRACK_BAD_PATH;
    if (path_size < sizeof *head + 8u * NUMBERS) return ADAPTRACK_TOO_SMALL;
    head->mark = 0;
    memory = (double *)(void *)(head + 1);
    if (!(noise >= 0.0)) noise = NAN;
    adaptrack_path_through(points, (int64_t)count, 2, closed != 0, noise, memory,
                           (int64_t)((path_size - sizeof *head) / 8u), answers);
    if (flaw) *flaw = (size_t)answers[1].whole;
    if (answers[0].whole == ADAPTRACK_PATH_TOO_SMALL) return ADAPTRACK_TOO_SMALL;
    if (answers[0].whole != 0) return ADAPTRACK_BAD_PATH;
    head->closed = closed != 0, head->pieces = (int64_t)memory[ADAPTRACK_ROAD_COUNT], head->of = 0;
    head->headings = (int64_t)(memory[ADAPTRACK_ROAD_LENGTH] / memory[ADAPTRACK_ROAD_SPACING] + 0.5) + 1;
    for (int i = 0; i < 3; i++) head->reserved[i] = 0;
    head->id = adaptrack_crc32(points, 16u * count) ^ adaptrack_crc32(&noise, sizeof noise) ^ (closed ? 0xffffffffu : 0u);
    head->mark = PATH;
    return ADAPTRACK_OK;
}

double adaptrack_path_length(const void *path) {
    const path_head *head = head_of(path);
    return head ? road_of(head)[ADAPTRACK_ROAD_LENGTH] : NAN;
}

double adaptrack_path_curvature(const void *path, double s) {
    const path_head *head = head_of(path);
    const double *headings;
    int64_t cell = 0;
    double place;
    if (!head || s - s != 0.0) return NAN;
    headings = road_of(head) + NUMBERS + (COLUMNS + 1) * head->pieces + 1;
    place = s / road_of(head)[ADAPTRACK_ROAD_SPACING];
    if (place > 0.0) cell = place < (double)(head->headings - 2) ? (int64_t)place : head->headings - 2;
    return (headings[cell + 1] - headings[cell]) / road_of(head)[ADAPTRACK_ROAD_SPACING];
}

typedef struct {
    const double *s, *speed;
    size_t count;
} speed_table; /* a planned speed; none without entries */

#if ADAPTRACK_PLANNER || !ADAPTRACK_SPEED_CONTROL
static int is_finite(double value) { return value - value == 0.0; }
#endif

#if !ADAPTRACK_SPEED_CONTROL
static double magnitude(double value) { return value < 0.0 ? -value : value; }

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
#endif

/* Let the record's road and plan be those of the caller. */
static void put_path(struct tracker_records_TrackerRecord *tracker, const path_head *head, const speed_table *plan) {
    const double *memory = road_of(head), *start = memory + NUMBERS + COLUMNS * head->pieces;
    tracker->path.of = whole_vector_of((int64_t *)(uintptr_t)&head->of, 1);
    tracker->path.numbers = matrix_at(memory, 1, NUMBERS);
    tracker->path.start = vector_at(start, head->pieces + 1);
    tracker->path.pieces = matrix_at(memory + NUMBERS, head->pieces, COLUMNS);
    tracker->path.headings = vector_at(start + head->pieces + 1, head->headings);
    tracker->plan.s = vector_at(plan->s, (int64_t)plan->count);
    tracker->plan.speed = vector_at(plan->speed, (int64_t)plan->count);
}

/* -- a plan: a head, places and speeds, then what the kernel writes ----------------------------------------------- */
#if ADAPTRACK_SPEED_CONTROL
typedef struct {
    uint64_t mark;
    uint32_t id;   /* CRC-32 of what follows the head */
    uint32_t path; /* of path_head */
    int64_t count, cells, stops;
    double top_speed, length;
    int64_t closed;
} plan_head;       /* 64 bytes, a cache line */
typedef char plan_head_has_64_bytes[sizeof(plan_head) == 64 ? 1 : -1];
static const uint64_t PLAN = 0x6e616c706b726461u; /* "adrkplan" */

static const plan_head *plan_of(const void *plan) {
    const plan_head *head = (const plan_head *)plan;
    return plan && (uintptr_t)plan % 8u == 0 && head->mark == PLAN ? head : 0;
}

static uint32_t plan_id(const void *memory) { return plan_of(memory)->id; }

/* How many numbers a plan takes besides its head. */
static size_t plan_numbers(const path_head *path, const adaptrack_speeds *speeds) {
    const double length = road_of(path)[ADAPTRACK_ROAD_LENGTH];
    return 2u * speeds->count +
           (size_t)adaptrack_speed_path_words(length, (int64_t)path->closed, (int64_t)speeds->stop_count);
}

static int is_table(const double *first, const double *second, size_t count) {
    return count <= ADAPTRACK_MOST_POINTS && (count == 0 || (first && second));
}

static int are_tables(const adaptrack_speeds *speeds) {
    return speeds && speeds->count > 0 && is_table(speeds->s, speeds->speed, speeds->count) &&
           is_table(speeds->grade.s, speeds->grade.value, speeds->grade.count) &&
           is_table(speeds->bank.s, speeds->bank.value, speeds->bank.count) &&
           is_table(speeds->stops, speeds->seconds, speeds->stop_count);
}

size_t adaptrack_speed_plan_size(const void *path, const adaptrack_speeds *speeds) {
    const path_head *head = head_of(path);
    return head && are_tables(speeds) ? sizeof(plan_head) + 8u * plan_numbers(head, speeds) : 0;
}

/* Tables of the caller along a road. */
static struct speed_path_PlanArrays arrays_of(const path_head *road, const adaptrack_speeds *speeds) {
    const double *line = road_of(road);
    struct speed_path_PlanArrays arrays;
    arrays.line.start = vector_at(line + NUMBERS + COLUMNS * road->pieces, road->pieces + 1);
    arrays.line.pieces = matrix_at(line + NUMBERS, road->pieces, COLUMNS);
    arrays.line.numbers = vector_at(line, NUMBERS);
    arrays.s = vector_at(speeds->s, (int64_t)speeds->count);
    arrays.speed = vector_at(speeds->speed, (int64_t)speeds->count);
    arrays.grade.s = vector_at(speeds->grade.s, (int64_t)speeds->grade.count);
    arrays.grade.value = vector_at(speeds->grade.value, (int64_t)speeds->grade.count);
    arrays.bank.s = vector_at(speeds->bank.s, (int64_t)speeds->bank.count);
    arrays.bank.value = vector_at(speeds->bank.value, (int64_t)speeds->bank.count);
    arrays.stops = vector_at(speeds->stops, (int64_t)speeds->stop_count);
    arrays.seconds = vector_at(speeds->seconds, (int64_t)speeds->stop_count);
    arrays.grade.steps = arrays.bank.steps = 0, arrays.stops_at_end = speeds->stays_at_end != 0;
    return arrays;
}

adaptrack_error adaptrack_speed_plan(const void *path, const adaptrack_speeds *speeds, void *plan, size_t plan_size,
                                     adaptrack_flaw *flaw) {
    const path_head *road = head_of(path);
    plan_head *head = (plan_head *)plan;
    struct speed_path_PlanArrays arrays;
    adaptrack_word answers[2];
    double *numbers;
    size_t tables, count;
    if (flaw) flaw->array = ADAPTRACK_PLAN_NO_FLAW, flaw->index = 0;
    if (!road) return ADAPTRACK_BAD_PATH;
    if (!are_tables(speeds) || !plan || (uintptr_t)plan % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) return ADAPTRACK_ARITHMETIC;
    if (plan_size < adaptrack_speed_plan_size(path, speeds)) return ADAPTRACK_TOO_SMALL;
    count = speeds->count, tables = 2u * count;
    head->mark = 0, head->length = road_of(road)[ADAPTRACK_ROAD_LENGTH], head->closed = (int64_t)road->closed;
    head->cells = (adaptrack_speed_path_words(head->length, head->closed, 0) - 2) / 4;
    numbers = (double *)(void *)(head + 1), arrays = arrays_of(road, speeds);
    adaptrack_write_speed_path(&arrays, numbers + tables, (int64_t)(plan_numbers(road, speeds) - tables), answers);
    if (answers[0].whole != 0) {
        if (flaw) flaw->array = (adaptrack_plan_array)answers[0].whole, flaw->index = (size_t)answers[1].whole;
        return ADAPTRACK_BAD_PLAN;
    }
    head->stops = answers[1].whole, head->top_speed = 0.0;
    for (size_t i = 0; i < count; i++) {
        numbers[i] = speeds->s[i], numbers[count + i] = speeds->speed[i];
        if (speeds->speed[i] > head->top_speed) head->top_speed = speeds->speed[i];
    }
    head->count = (int64_t)count, head->path = road->id;
    head->id = adaptrack_crc32(numbers, 8u * (tables + 4u * (size_t)head->cells + 2u * (size_t)head->stops));
    head->mark = PLAN;
    return ADAPTRACK_OK;
}

/* Let the record's speed control follow a plan from its start. */
static adaptrack_error put_plan(tracking *record, const void *memory) {
    const plan_head *head = plan_of(memory);
    const double *numbers = (const double *)(const void *)(head + 1) + 2 * head->count;
    const double *stops = numbers + 4 * head->cells;
    struct speed_speed_control_SpeedPath *path = &record->longitudinal.path;
    const int64_t horizon =
        adaptrack_horizon_cells(head->top_speed, record->longitudinal.settings.brake, ADAPTRACK_PLAN_SPACING);
    if (horizon > ADAPTRACK_LONGITUDINAL_CELLS) return ADAPTRACK_BAD_PLAN;
    path->square = vector_at(numbers, head->cells);
    path->curvature = vector_at(numbers + head->cells, head->cells);
    path->slope = vector_at(numbers + 2 * head->cells, head->cells);
    path->bank = vector_at(numbers + 3 * head->cells, head->cells);
    path->stops = vector_at(stops, head->stops);
    path->seconds = vector_at(stops + head->stops, head->stops);
    path->spacing = head->length / (double)(head->closed ? head->cells : head->cells - 1);
    path->length = head->length, path->closed = head->closed;
    record->longitudinal.ahead.size[0] = horizon;
    adaptrack_longitudinal_follow(&record->longitudinal);
    return ADAPTRACK_OK;
}

static void read_requests(const tracking *record, adaptrack_answer *answer) {
    const struct speed_speed_control_SpeedMemory *memory = record->longitudinal.memory.data;
    const struct speed_friction_FrictionMemory *friction = record->longitudinal.friction.memory.data;
@READ_REQUESTS@
}
#else
static uint32_t plan_id(const void *memory) { return memory ? 1u : 0u; }
static adaptrack_error put_plan(tracking *record, const void *memory) {
    return record && !memory ? ADAPTRACK_OK : ADAPTRACK_BAD_ARGUMENT;
}
#endif

/* By which a path and its plan are known again. */
static uint32_t path_id(const path_head *head, const speed_table *plan) {
    uint32_t parts[3] = {head->id, 0, 0};
    if (plan->count > 0) {
        parts[1] = adaptrack_crc32(plan->s, 8u * plan->count);
        parts[2] = adaptrack_crc32(plan->speed, 8u * plan->count);
    }
    return adaptrack_crc32(parts, sizeof parts) | 1u;
}

/* -- constants ---------------------------------------------------------------------------------------------------- */
enum {
    CONSTANTS_WORDS = sizeof(struct adaptrack_constants) / 8,
    STATE_BEGIN = offsetof(memory_of_tracker, state) / 8,
    STATE_WORDS = sizeof(struct adaptrack_state) / 8
};

static double number_of(uint64_t bits) {
    adaptrack_word word;
    word.whole = (int64_t)bits;
    return word.number;
}

/* Constants of this layout whose numbers are within their bounds. So no kernel leaves its arrays. */
static adaptrack_error check_constants(adaptrack_file *file, const void *constants, size_t size) {
    const uint64_t *exported = (const uint64_t *)adaptrack_constants;
    const adaptrack_bounds *bounds = adaptrack_words;
    adaptrack_error error = adaptrack_read_constants(file, constants, size, ADAPTRACK_KERNELS);
    if (error != ADAPTRACK_OK) return error;
    if (file->id != ADAPTRACK_LAYOUT || size != sizeof(struct adaptrack_constants)) return ADAPTRACK_OTHER_SIZES;
    for (size_t i = ADAPTRACK_FILE_HEAD; i < CONSTANTS_WORDS; i++) {
        const uint64_t word = adaptrack_file_word(file, i);
        const double number = number_of(word);
        int is_right = 1;
        if (i == bounds->first + bounds->count) bounds++;
        if (bounds->rule == EXACT) is_right = word == exported[i];
        if (bounds->rule == NUMBER) is_right = number == number;
        if (bounds->rule == BETWEEN) is_right = number >= bounds->least && number <= bounds->most;
        if (bounds->rule == SAME) is_right = word == adaptrack_file_word(file, bounds->twin);
        if (!is_right) return ADAPTRACK_DAMAGED;
    }
    return ADAPTRACK_OK;
}

static void copy_constants(memory_of_tracker *memory, const adaptrack_file *file) {
    uint64_t *words = (uint64_t *)(void *)&memory->constants;
    for (size_t i = 0; i < CONSTANTS_WORDS; i++) words[i] = adaptrack_file_word(file, i);
    adaptrack_renew(memory);
}

#if ADAPTRACK_LEARNS
/* Whether learning begins with other numbers than it did. */
static int learns_anew(const memory_of_tracker *memory, const adaptrack_file *file) {
    const size_t first = offsetof(struct adaptrack_constants, controller_mpc_informed_fresh) / 8;
    const uint64_t *fresh = (const uint64_t *)(const void *)memory->constants.controller_mpc_informed_fresh;
    for (size_t i = 0; i < sizeof memory->constants.controller_mpc_informed_fresh / 8; i++)
        if (adaptrack_file_word(file, first + i) != fresh[i]) return 1;
    return 0;
}
#endif

/* -- the tracker -------------------------------------------------------------------------------------------------- */
size_t adaptrack_size(const void *constants, size_t size) {
    adaptrack_file file;
    return adaptrack_read_constants(&file, constants, size, ADAPTRACK_KERNELS) == ADAPTRACK_OK ? ADAPTRACK_SIZE : 0;
}

const char *adaptrack_version(void) { return ADAPTRACK_VERSION; }

const char *adaptrack_error_name(adaptrack_error error) {
    switch (error) {
@ERROR_NAMES@
    }
    return "an unknown error";
}

adaptrack_error adaptrack_init(void *tracker, size_t tracker_size, const void *constants, size_t size) {
    memory_of_tracker *memory = (memory_of_tracker *)tracker;
    uint64_t *words = (uint64_t *)tracker;
    adaptrack_file file;
    adaptrack_error error;
    if (!tracker || (uintptr_t)tracker % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    error = check_constants(&file, constants, size);
    if (error != ADAPTRACK_OK) return error;
    if (tracker_size < sizeof *memory) return ADAPTRACK_TOO_SMALL;
    error = adaptrack_arithmetic();
    if (error == ADAPTRACK_OK) error = adaptrack_compiled_exactly();
    if (error != ADAPTRACK_OK) return error;
    for (size_t i = 0; i < sizeof *memory / 8u; i++) words[i] = 0;
    adaptrack_connect(memory);
    copy_constants(memory, &file);
#if ADAPTRACK_PLANS
    adaptrack_mpc_prepare(&memory->record.controller.mpc);
#endif
    adaptrack_tracker_engage(0.0, NAN, &memory->record.tracker);
#if ADAPTRACK_SPEED_CONTROL
    adaptrack_longitudinal_begin(&memory->record.longitudinal);
#endif
    adaptrack_begin(&memory->head, &file, ADAPTRACK_KERNELS, STATE_BEGIN, STATE_WORDS);
    return ADAPTRACK_OK;
}

/* Replace the constants of a tracker; what it has learned stays unless learning begins with other numbers. */
static adaptrack_error load(memory_of_tracker *memory, const void *constants, size_t size) {
    adaptrack_file file;
    adaptrack_error error = check_constants(&file, constants, size);
    if (error == ADAPTRACK_OK) error = adaptrack_arithmetic();
    if (error != ADAPTRACK_OK) return error;
    {
#if ADAPTRACK_LEARNS
        const int is_new_car = learns_anew(memory, &file);
#endif
#if ADAPTRACK_PLANS
        struct controllers_mpc_Mpc mpc;
#endif
        copy_constants(memory, &file);
        memory->head.constants = file.checksum;
#if ADAPTRACK_LEARNS
        for (size_t i = 0; is_new_car && i < sizeof memory->state.controller_mpc_informed_learned / 8; i++)
            memory->state.controller_mpc_informed_learned[i] = memory->constants.controller_mpc_informed_fresh[i];
#endif
#if ADAPTRACK_PLANS
        mpc = memory->record.controller.mpc;
        mpc.memory.size[0] = 0; /* what the MPC remembers stays */
        adaptrack_mpc_prepare(&mpc);
        memory->state.controller_mpc_memory[0].speed = NAN; /* the model is formed anew */
#endif
    }
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_load(void *tracker, const void *constants, size_t size) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = load((memory_of_tracker *)tracker, constants, size);
    adaptrack_give(tracker);
    return error;
}

adaptrack_error adaptrack_engage(void *tracker, double wheel_angle, double near) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) error = ADAPTRACK_ARITHMETIC;
    else if (adaptrack_tracker_engage(wheel_angle, near, &record_of(tracker)->tracker) == 0) error = ADAPTRACK_BAD_ARGUMENT;
    adaptrack_give(tracker);
    return error;
}

#if ADAPTRACK_PLANNER
/* -- a planner ---------------------------------------------------------------------------------------------------- */
enum { POINT_COLUMNS = sizeof(adaptrack_point) / sizeof(double) };
typedef struct {
    uint64_t mark;
    followed record; /* of the arrays behind it */
    struct tracker_followed_FollowedMemory memory;
    struct planned_records_PlannedMemory memory_before;
    int64_t road, parts[2 * ADAPTRACK_PARTS];
    double fallback[POINT_COLUMNS * ADAPTRACK_TRAJECTORY_POINTS];
    double numbers[2 * (ADAPTRACK_TRAJECTORY_WORDS + ADAPTRACK_TRAJECTORY_PLAN_WORDS)]; /* of buffers and plans */
} planner;
typedef char planner_has_room[sizeof(planner) <= ADAPTRACK_PLANNER_SIZE ? 1 : -1];
static const uint64_t PLANNER = 0x6e6c706b72746461u; /* "adtrkpln" */

static planner *planner_of(const void *tracker) {
    return (planner *)(uintptr_t)((const adaptrack_head *)tracker)->planner;
}

static int follows_trajectory(const void *tracker) {
    return planner_of(tracker) && planner_of(tracker)->memory.half >= 0;
}

static void connect_planner(planner *own, const struct vector *ahead) {
    followed *record = &own->record;
    double *plans = own->numbers + 2 * ADAPTRACK_TRAJECTORY_WORDS;
    own->road = 0, own->memory.half = -1, own->memory.fallback_count = 0;
    record->memory = rows_of_tracker_followed_FollowedMemory_of(&own->memory, 1);
    record->buffers = matrix_of(own->numbers, 2, ADAPTRACK_TRAJECTORY_WORDS);
    record->parts = whole_matrix_of(own->parts, 2, ADAPTRACK_PARTS);
    record->plans = matrix_of(plans, 2, ADAPTRACK_TRAJECTORY_PLAN_WORDS);
    record->ahead = vector_of(ahead->data, ADAPTRACK_LONGITUDINAL_CELLS);
    record->road = whole_vector_of(&own->road, 1);
    record->fallback = matrix_of(own->fallback, ADAPTRACK_TRAJECTORY_POINTS, POINT_COLUMNS);
    record->memory_before = rows_of_planned_records_PlannedMemory_of(&own->memory_before, 1);
    own->mark = PLANNER;
}

adaptrack_error adaptrack_planner(void *tracker, void *memory, size_t size) {
    adaptrack_error error;
    if (!memory || (uintptr_t)memory % 8u != 0) return ADAPTRACK_BAD_ARGUMENT;
    if (size < sizeof(planner)) return ADAPTRACK_TOO_SMALL;
    error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    if (follows_trajectory(tracker)) {
        error = ADAPTRACK_OUT_OF_ORDER;
    } else {
        connect_planner((planner *)memory, &record_of(tracker)->longitudinal.ahead);
        ((adaptrack_head *)tracker)->planner = (uint64_t)(uintptr_t)memory;
    }
    adaptrack_give(tracker);
    return error;
}

/* Follow no trajectory any more. */
static void leave_planner(void *tracker) {
    planner *own = planner_of(tracker);
    adaptrack_leave_planner(&record_of(tracker)->tracker);
    if (own) own->memory.half = -1, own->memory.fallback_count = 0;
}

/* Set the id of the path to that of the followed trajectory: of its line, as it is joined, and its times. */
static void identify_trajectory(void *tracker) {
    const planner *own = planner_of(tracker);
    const int64_t *parts;
    const double *points, *times;
    if (!follows_trajectory(tracker) || own->mark != PLANNER) return;
    parts = own->parts + own->memory.half * ADAPTRACK_PARTS;
    points = own->numbers + own->memory.half * ADAPTRACK_TRAJECTORY_WORDS;
    times = points + parts[ADAPTRACK_PART_SPEEDS_AT] + 2 * parts[ADAPTRACK_PART_ROOM];
    ((adaptrack_head *)tracker)->path = 1u | (adaptrack_crc32(points, 24u * (size_t)parts[ADAPTRACK_PART_POINTS]) ^
                                              adaptrack_crc32(times, 8u * (size_t)parts[ADAPTRACK_PART_SPEEDS]));
}

static const double *numbers_of(const adaptrack_trajectory *trajectory) {
    return (const double *)(const void *)trajectory->points; /* they have nothing but numbers */
}

static adaptrack_error check_points(const adaptrack_trajectory *trajectory) {
    if (!trajectory->points && trajectory->count > 0) return ADAPTRACK_BAD_ARGUMENT;
    return trajectory->count <= ADAPTRACK_TRAJECTORY_POINTS ? ADAPTRACK_OK : ADAPTRACK_TOO_SMALL;
}

static adaptrack_error error_of(int64_t verdict, int64_t flaw) {
    if (verdict == ADAPTRACK_BAD_FALLBACK_VERDICT) return ADAPTRACK_BAD_FALLBACK;
    if (flaw == ADAPTRACK_FLAW_TOO_LONG) return ADAPTRACK_TOO_SMALL;
    if (flaw == ADAPTRACK_FLAW_TOO_FAST) return ADAPTRACK_BAD_PLAN;
    return flaw == 0 ? ADAPTRACK_OK : ADAPTRACK_BAD_TRAJECTORY;
}

adaptrack_error adaptrack_follow_trajectory(void *tracker, const adaptrack_trajectory *trajectory,
                                            const adaptrack_trajectory *fallback, adaptrack_verdict *verdict,
                                            size_t *flaw) {
    static const adaptrack_trajectory NONE = {0};
    const adaptrack_trajectory *last = fallback ? fallback : &NONE;
    struct tracker_planner_Arrival arrival;
    adaptrack_word answers[3] = {{0}};
    adaptrack_error error;
    if (!trajectory || !verdict) return ADAPTRACK_BAD_ARGUMENT;
    error = check_points(trajectory);
    if (error == ADAPTRACK_OK) error = check_points(last);
    if (error == ADAPTRACK_OK) error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    arrival.stamp = trajectory->stamp, arrival.time = trajectory->now, arrival.is_urgent = trajectory->is_urgent != 0;
    if (arrival.time != arrival.time) arrival.time = record_of(tracker)->tracker.memory.data->last;
    arrival.role = ADAPTRACK_DRIVEN_BY_PLANNER;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) error = ADAPTRACK_ARITHMETIC;
    else if (!planner_of(tracker) || !is_finite(arrival.time)) error = ADAPTRACK_OUT_OF_ORDER;
    else if (planner_of(tracker)->mark != PLANNER) error = ADAPTRACK_NOT_READY;
    else if (fallback && fallback->count == 0) error = ADAPTRACK_BAD_FALLBACK;
    if (error == ADAPTRACK_OK) {
        adaptrack_join_trajectory(numbers_of(trajectory), (int64_t)trajectory->count, POINT_COLUMNS, &arrival,
                                  numbers_of(last), (int64_t)last->count, POINT_COLUMNS, last->is_urgent != 0,
                                  record_of(tracker), &planner_of(tracker)->record, answers);
        error = error_of(answers[0].whole, answers[1].whole);
        if (error == ADAPTRACK_OK) *verdict = (adaptrack_verdict)answers[0].whole;
    }
    if (flaw) *flaw = (size_t)answers[2].whole;
    adaptrack_give(tracker);
    return error;
}
#else
static void leave_planner(void *tracker) { (void)tracker; }
static void identify_trajectory(void *tracker) { (void)tracker; }
#endif

/* Go over to a path and its plan; `memory`: of the plan, null in an export without speed control. */
static adaptrack_error follow(void *tracker, const path_head *head, double near, const speed_table *plan,
                              const void *memory) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    if (adaptrack_arithmetic() != ADAPTRACK_OK) error = ADAPTRACK_ARITHMETIC;
    else error = put_plan(record_of(tracker), memory);
    if (error == ADAPTRACK_OK) {
        put_path(&record_of(tracker)->tracker, head, plan);
        leave_planner(tracker);
        adaptrack_tracker_follow(near, &record_of(tracker)->tracker);
        ((adaptrack_head *)tracker)->path = path_id(head, plan) ^ plan_id(memory);
        ((adaptrack_head *)tracker)->points = head->id;
    }
    adaptrack_give(tracker);
    return error;
}

#if ADAPTRACK_SPEED_CONTROL
adaptrack_error adaptrack_follow_plan(void *tracker, const void *path, double near, const void *plan) {
    const path_head *head = head_of(path);
    const plan_head *own = plan_of(plan);
    speed_table table;
    if (!head) return ADAPTRACK_BAD_PATH;
    if (!own || own->path != head->id) return ADAPTRACK_BAD_PLAN;
    table.s = (const double *)(const void *)(own + 1), table.count = (size_t)own->count;
    table.speed = table.s + own->count;
    return follow(tracker, head, near, &table, plan);
}

static adaptrack_error tell_speed_control(void *tracker, void (*kernel)(longitudinal *)) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    kernel(&record_of(tracker)->longitudinal);
    adaptrack_give(tracker);
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_release(void *tracker) { return tell_speed_control(tracker, adaptrack_longitudinal_release); }

adaptrack_error adaptrack_acknowledge_fault(void *tracker) {
    return tell_speed_control(tracker, adaptrack_longitudinal_acknowledge);
}
#else
adaptrack_error adaptrack_follow(void *tracker, const void *path, double near, const adaptrack_plan *plan) {
    const path_head *head = head_of(path);
    speed_table table = {0, 0, 0};
    adaptrack_error error;
    if (!head) return ADAPTRACK_BAD_PATH;
    error = check_plan(plan, head);
    if (error != ADAPTRACK_OK) return error;
    if (plan && plan->count > 0) table.s = plan->s, table.speed = plan->speed, table.count = plan->count;
    return follow(tracker, head, near, &table, 0);
}
#endif

/* A number that stands for a status or a state, 0 where it is none. */
static int small(double value) { return value > -1000.0 && value < 1000.0 ? (int)value : 0; }

/* A number of bits, 0 where it is none. */
static uint64_t bits(double value) { return value >= 1.0 && value < 9e15 ? (uint64_t)value : 0u; }

static void read_answer(const double *tracked, adaptrack_answer *answer) {
@READ_ANSWER@
}

/* ADAPTRACK_BAD_PATH where the path that is followed has been overwritten. */
static adaptrack_error check_path(void *tracker) {
    const adaptrack_head *own = (const adaptrack_head *)tracker;
    const path_head *head;
#if ADAPTRACK_PLANNER
    if (planner_of(tracker) && planner_of(tracker)->mark != PLANNER) return ADAPTRACK_BAD_PATH;
    if (follows_trajectory(tracker)) return ADAPTRACK_OK;
#endif
    if (own->path == 0) return ADAPTRACK_OUT_OF_ORDER;
    head = (const path_head *)(const void *)record_of(tracker)->tracker.path.numbers.data - 1;
    if (head->mark != PATH || head->id != own->points) return ADAPTRACK_BAD_PATH;
#if ADAPTRACK_SPEED_CONTROL
    if (((const plan_head *)(const void *)record_of(tracker)->tracker.plan.s.data - 1)->mark != PLAN)
        return ADAPTRACK_BAD_PLAN;
#endif
    return ADAPTRACK_OK;
}

adaptrack_error adaptrack_step(void *tracker, const adaptrack_sample *sample, adaptrack_answer *answer) {
    const double *signals = (const double *)(const void *)sample; /* it has nothing but numbers */
    adaptrack_error error;
    double *row;
    if (!sample || !answer) return ADAPTRACK_BAD_ARGUMENT;
    error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_arithmetic();
    if (error == ADAPTRACK_OK) error = check_path(tracker);
    if (error == ADAPTRACK_OK) {
        row = record_of(tracker)->tracker.sample.data;
        for (size_t i = 0; i < sizeof *sample / sizeof *row; i++) row[i] = signals[i];
#if ADAPTRACK_PLANNER
        if (planner_of(tracker)) adaptrack_trajectory_step(record_of(tracker), &planner_of(tracker)->record);
        else
#endif
            adaptrack_tracker_step(record_of(tracker));
        read_answer(record_of(tracker)->tracker.tracked.data, answer);
#if ADAPTRACK_PLANNER && !ADAPTRACK_SPEED_CONTROL
        answer->target_speed = NAN;
        if (answer->driven_by > 0)
            answer->target_speed = record_of(tracker)->tracker.planned.memory.data->target_speed;
#endif
#if ADAPTRACK_SPEED_CONTROL
        read_requests(record_of(tracker), answer);
#endif
    }
    adaptrack_give(tracker);
    return error;
}

adaptrack_error adaptrack_predicted_path(void *tracker, double *points, size_t room, size_t *count, double *first) {
    adaptrack_word answers[2];
    adaptrack_error error;
    if (!count || !first || (!points && room > 0)) return ADAPTRACK_BAD_ARGUMENT;
    error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    error = adaptrack_arithmetic();
    if (error == ADAPTRACK_OK) error = check_path(tracker);
    if (error == ADAPTRACK_OK) {
        if (room > ADAPTRACK_HORIZON) room = ADAPTRACK_HORIZON;
#if ADAPTRACK_PLANNER
        if (planner_of(tracker))
            adaptrack_trajectory_predict(record_of(tracker), &planner_of(tracker)->record, points, 2 * (int64_t)room,
                                         answers);
        else
#endif
            adaptrack_tracker_predict(record_of(tracker), points, 2 * (int64_t)room, answers);
        *count = (size_t)answers[0].whole, *first = answers[1].number;
        if (*count > room) error = ADAPTRACK_TOO_SMALL;
    }
    adaptrack_give(tracker);
    return error;
}

/* -- the state ---------------------------------------------------------------------------------------------------- */
size_t adaptrack_state_size(const void *tracker) { return adaptrack_saved_size(tracker); }

adaptrack_error adaptrack_save(void *tracker, void *state, size_t size) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    identify_trajectory(tracker);
    error = adaptrack_save_state(tracker, state, size);
    adaptrack_give(tracker);
    return error;
}

adaptrack_error adaptrack_restore(void *tracker, const void *state, size_t size) {
    adaptrack_error error = adaptrack_take(tracker);
    if (error != ADAPTRACK_OK) return error;
    identify_trajectory(tracker);
    error = adaptrack_restore_state(tracker, state, size);
    adaptrack_give(tracker);
    return error;
}
