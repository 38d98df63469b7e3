/* adaptrack: bounds of all sizes, counts and numbers of constants, so that no kernel leaves its arrays. */
#include "adaptrack_bounds.h"

#include "adaptrack_config.h"
#include "adaptrack_parts.h"
#include "records.h"

enum { CACHE_LINE = 8, MOST_WORDS = 1 << 26 };
#define BOUND(holds) \
    if (!(holds)) return ADAPTRACK_DAMAGED

typedef union {
    uint64_t bits;
    int64_t whole;
    double number;
} content;

static const adaptrack_array *array_of(uint32_t i) { return adaptrack_arrays + i; }

static content word_at(const adaptrack_block *b, uint64_t place) {
    adaptrack_cursor r = adaptrack_block_from(b, (uint32_t)(place < b->words ? place : b->words));
    content found;
    found.bits = adaptrack_block_next(&r);
    return found;
}

/* The word at which an array begins. */
static uint32_t place_of(const adaptrack_block *b, uint32_t i) { return adaptrack_block_number(b->place, 2u * i + 1u); }

static int64_t size_of(const adaptrack_block *b, uint32_t i, uint32_t k) {
    return word_at(b, array_of(i)->word + 1u + (uint64_t)k).whole;
}

static content entry_of(const adaptrack_block *b, uint32_t i, int64_t k) {
    return word_at(b, place_of(b, i) + (uint64_t)k);
}

/* A word of an array, or of the record itself. */
static content number_of(const adaptrack_block *b, uint32_t array, uint32_t word) {
    return array < ADAPTRACK_ARRAYS ? entry_of(b, array, word) : word_at(b, word);
}

/* Words of an array; more than there can be for a size that is none. */
static uint64_t words_of(const adaptrack_block *b, uint32_t i) {
    uint64_t words = array_of(i)->entry;
    for (uint32_t k = 0; k < array_of(i)->sizes; k++) {
        int64_t size = size_of(b, i, k);
        if (size < 0 || size > MOST_WORDS || words > MOST_WORDS) return (uint64_t)MOST_WORDS + 1u;
        words *= (uint64_t)size;
    }
    return words;
}

static uint32_t aligned(uint32_t place) { return place + (CACHE_LINE - place % CACHE_LINE) % CACHE_LINE; }

typedef struct tracker_step_Tracking tracking;

/* Whether the words of a part of the record are zero: the caller gives it. */
static int are_zero(const adaptrack_block *b, size_t begin, size_t size) {
    for (size_t i = begin / 8u; i < (begin + size) / 8u; i++)
        if (word_at(b, (uint32_t)i).bits != 0) return 0;
    return 1;
}

/* Every array lies where its size and role put it, one behind the other, and they fill the memory. */
static adaptrack_error check_places(const adaptrack_block *b) {
    uint32_t end = b->record;
    BOUND(b->record == ADAPTRACK_RECORD_WORDS && b->places == ADAPTRACK_ARRAYS && b->words <= MOST_WORDS);
    for (uint32_t role = ADAPTRACK_FIXED; role <= ADAPTRACK_KEPT; role++) {
        end = aligned(end);
        BOUND(role != ADAPTRACK_RENEWED || b->renewed == end);
        BOUND(role != ADAPTRACK_KEPT || b->kept == end);
        for (uint32_t i = 0; i < ADAPTRACK_ARRAYS; i++) {
            uint64_t words = words_of(b, i);
            if (array_of(i)->role != role) continue;
            if (words >= CACHE_LINE) end = aligned(end);
            BOUND(end <= b->words && words <= b->words - end);
            BOUND(adaptrack_block_number(b->place, 2u * i) == array_of(i)->word);
            BOUND(place_of(b, i) == (words > 0 ? end : 0));
            end += (uint32_t)words;
            for (uint32_t k = 0; k < array_of(i)->sizes; k++)
                BOUND(array_of(i)->open || size_of(b, i, k) == array_of(i)->size[k]);
        }
    }
    return end == b->words ? ADAPTRACK_OK : ADAPTRACK_DAMAGED;
}

/* The kernels are those of the library; what the caller gives is empty. */
static adaptrack_error check_links(const adaptrack_block *b) {
    if (b->links != ADAPTRACK_LINKS) return ADAPTRACK_OTHER_KIND;
    for (uint32_t i = 0; i < 2 * ADAPTRACK_LINKS; i++)
        if (adaptrack_block_number(b->link, i) != adaptrack_links[i]) return ADAPTRACK_OTHER_KIND;
    BOUND(are_zero(b, offsetof(tracking, tracker.path), sizeof(struct roads_road_Roads)));
    BOUND(are_zero(b, offsetof(tracking, tracker.plan), sizeof(struct tracker_records_PlanRecord)));
#if ADAPTRACK_SPEED_CONTROL
    BOUND(are_zero(b, offsetof(tracking, longitudinal.path), sizeof(struct speed_speed_control_SpeedPath)));
#endif
    return ADAPTRACK_OK;
}

/* Numbers of the record and its rows are within their bounds, what stands there twice is equal, and all others are
   numbers. */
static adaptrack_error check_numbers(const adaptrack_block *b) {
    adaptrack_cursor r = adaptrack_block_from(b, b->record);
    for (uint32_t i = 0; i < ADAPTRACK_BOUNDS; i++) {
        const adaptrack_bound *bound = adaptrack_bounds + i;
        content found = number_of(b, bound->array, bound->word);
        double number = bound->whole == 1 ? (double)found.whole : found.number;
        if (bound->array < ADAPTRACK_ARRAYS && words_of(b, bound->array) == 0) continue; /* no such part */
        BOUND(bound->whole == 2 ? number != number : number >= bound->least && number <= bound->most);
    }
    for (uint32_t i = 0; i < ADAPTRACK_EQUALS; i++) {
        const adaptrack_equal *equal = adaptrack_equals + i;
        if (equal->other_array < ADAPTRACK_ARRAYS && words_of(b, equal->other_array) == 0) continue; /* no such part */
        BOUND(number_of(b, equal->array, equal->word).bits == number_of(b, equal->other_array, equal->other_word).bits);
    }
    for (uint32_t i = 0; i < ADAPTRACK_ARRAYS; i++) { /* FIXED come before RENEWED, each in the order of the record */
        if (array_of(i)->role == ADAPTRACK_KEPT || array_of(i)->other) continue;
        if (place_of(b, i) < r.at) r = adaptrack_block_from(b, b->record);
        r.at = place_of(b, i);
        for (uint64_t k = words_of(b, i); k > 0; k--) {
            content found;
            found.bits = adaptrack_block_next(&r);
            BOUND(found.number == found.number);
        }
    }
    return ADAPTRACK_OK;
}

static double car_of(const adaptrack_block *b, int64_t field) { return entry_of(b, ADAPTRACK_AT_CAR, field).number; }

/* The numbers of the car in the check of the inputs are those of the tracker, and its limits leave an angle. */
static adaptrack_error check_car(const adaptrack_block *b) {
    const double load = entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_DRIFT_LOAD).number, slip = car_of(b, ADAPTRACK_CAR_SLIP);
    const double expected = load / entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_DRIFT_STIFFNESS).number;
    BOUND(entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_ANGLE_MIN).number <
          entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_ANGLE_MAX).number);
    BOUND(car_of(b, ADAPTRACK_CAR_KNOWN) == 1.0);
    BOUND(car_of(b, ADAPTRACK_CAR_LENGTH) == car_of(b, ADAPTRACK_CAR_LF) + car_of(b, ADAPTRACK_CAR_LR));
    BOUND(slip > 0.0 && expected < slip * (1.0 + 1e-9) && expected > slip * (1.0 - 1e-9));
    return ADAPTRACK_OK;
}

/* The state is that before the first step. */
static adaptrack_error check_state(const adaptrack_block *b, uint32_t learned, uint32_t learned_end) {
    adaptrack_cursor r = adaptrack_block_from(b, b->kept);
    uint32_t n = 0;
    while (r.at < b->words) {
        uint32_t place = r.at;
        content found;
        found.bits = adaptrack_block_next(&r);
        if (found.bits == 0 || (place >= learned && place < learned_end)) continue;
        BOUND(n < ADAPTRACK_INITIALS && place == place_of(b, adaptrack_initials[n].array) + adaptrack_initials[n].word);
        BOUND(found.bits == (adaptrack_initials[n].value ? adaptrack_initials[n].value
                                                         : entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_PERIOD_AT).bits));
        n++;
    }
    return n == ADAPTRACK_INITIALS ? ADAPTRACK_OK : ADAPTRACK_DAMAGED;
}

/* -- a schedule --------------------------------------------------------------------------------------------------- */
typedef struct {
    int64_t integers, numbers, work; /* that a function needs, from where it begins */
} extent;

static int64_t integer_of(const adaptrack_block *b, int64_t k) {
    int64_t size = size_of(b, ADAPTRACK_AT_INTEGERS, 0);
    return k >= 0 && k < size ? entry_of(b, ADAPTRACK_AT_INTEGERS, k).whole : -1;
}

static int within(int64_t value, int64_t least, int64_t most) { return value >= least && value <= most; }

static adaptrack_error check_network(const adaptrack_block *b, int64_t at, int64_t inputs, extent *e) {
    int64_t layers = integer_of(b, at + 1), wide = inputs;
    BOUND(within(layers, 1, 100) && integer_of(b, at + 2) == inputs);
    e->integers = 3 + layers, e->numbers = 2 + 2 * inputs, e->work = inputs;
    for (int64_t i = 0; i < layers; i++) {
        int64_t next = integer_of(b, at + 3 + i);
        BOUND(within(next, 1, 10000));
        e->numbers += (wide + 1) * next;
        if (i < layers - 1) e->work += next;
        wide = next;
    }
    return ADAPTRACK_OK;
}

static adaptrack_error check_fuzzy(const adaptrack_block *b, int64_t at, int64_t inputs, extent *e) {
    int64_t functions = integer_of(b, at + 1), rules = integer_of(b, at + 2), first = at + 3 + 2 * functions;
    BOUND(integer_of(b, at) == inputs && within(functions, 0, 100000) && within(rules, 1, 100000));
    e->integers = 3 + 2 * functions + rules * inputs;
    e->numbers = 3 * functions + rules * (inputs + 2), e->work = functions + rules;
    for (int64_t i = 0; i < functions; i++) BOUND(within(integer_of(b, at + 3 + i), 0, inputs - 1));
    for (int64_t i = 0; i < rules * inputs; i++) {
        BOUND(first + i < size_of(b, ADAPTRACK_AT_INTEGERS, 0));
        BOUND(within(integer_of(b, first + i), -1, functions - 1));
    }
    return ADAPTRACK_OK;
}

static adaptrack_error check_table(const adaptrack_block *b, int64_t at, int64_t inputs, extent *e) {
    int64_t values = 1;
    BOUND(integer_of(b, at) == inputs);
    e->integers = 1 + inputs, e->numbers = 0, e->work = 2 * inputs;
    for (int64_t i = 0; i < inputs; i++) {
        int64_t size = integer_of(b, at + 1 + i);
        BOUND(within(size, 1, MOST_WORDS / values));
        e->numbers += size, values *= size;
    }
    e->numbers += values;
    return ADAPTRACK_OK;
}

/* A packed function lies within the arrays and needs no more scratch than there is. */
static adaptrack_error check_function(const adaptrack_block *b, int64_t kind, int64_t at, int64_t number, int64_t inputs,
                                      int64_t scratch) {
    extent e = {0, 1, 0};
    adaptrack_error error = ADAPTRACK_OK;
    if (kind == ADAPTRACK_NETWORK) error = check_network(b, at, inputs, &e);
    else if (kind == ADAPTRACK_SUGENO) error = check_fuzzy(b, at, inputs, &e);
    else if (kind != ADAPTRACK_NUMBER) error = check_table(b, at, inputs, &e);
    if (error != ADAPTRACK_OK) return error;
    BOUND(at >= 0 && e.integers <= size_of(b, ADAPTRACK_AT_INTEGERS, 0) - at);
    BOUND(number >= 0 && e.numbers <= size_of(b, ADAPTRACK_AT_NUMBERS, 0) - number);
    BOUND(e.work <= scratch);
    return ADAPTRACK_OK;
}

static int64_t of_schedule(const adaptrack_block *b, int64_t field) {
    return entry_of(b, ADAPTRACK_AT_SCHEDULE, field).whole;
}

static adaptrack_error check_schedule(const adaptrack_block *b) {
    const int64_t inputs = of_schedule(b, ADAPTRACK_SCHEDULE_N_INPUTS), tuning = size_of(b, ADAPTRACK_AT_TUNING, 1);
    const int64_t entries = of_schedule(b, ADAPTRACK_SCHEDULE_N_ENTRIES), scratch = size_of(b, ADAPTRACK_AT_SCRATCH, 0);
    adaptrack_error error = ADAPTRACK_OK;
    BOUND(size_of(b, ADAPTRACK_AT_FIRST, 0) == tuning && size_of(b, ADAPTRACK_AT_TUNING, 0) == 1);
    if (entries == 0) return ADAPTRACK_OK;
    BOUND(entries == tuning && size_of(b, ADAPTRACK_AT_COUNTS, 0) == 1);
    BOUND(of_schedule(b, ADAPTRACK_SCHEDULE_OF_MPC) == ADAPTRACK_OF_MPC);
    for (int64_t i = 0; i < entries && error == ADAPTRACK_OK; i++) {
        const int64_t at = ADAPTRACK_SCHEDULE_ENTRIES + i * ADAPTRACK_ENTRY_WORDS;
        error = check_function(b, of_schedule(b, at), of_schedule(b, at + 1), of_schedule(b, at + 2), inputs,
                               scratch - ADAPTRACK_SCHEDULE_SCRATCH);
    }
    if (error != ADAPTRACK_OK || !of_schedule(b, ADAPTRACK_GUARD_USED)) return error;
    BOUND(ADAPTRACK_OF_MPC);
    if (!of_schedule(b, ADAPTRACK_GUARD_MAPPED)) return ADAPTRACK_OK;
    return check_function(b, ADAPTRACK_MULTILINEAR, of_schedule(b, ADAPTRACK_GUARD_INTEGERS),
                          of_schedule(b, ADAPTRACK_GUARD_NUMBERS), ADAPTRACK_MAP_AXES,
                          scratch - ADAPTRACK_SCHEDULE_SCRATCH - ADAPTRACK_MAP_AXES);
}

/* -- an MPC ------------------------------------------------------------------------------------------------------- */
#if ADAPTRACK_OF_MPC
extern int64_t adaptrack_mpc_sizes(void *settings, void *counts, int64_t *table, int64_t rows, int64_t columns);

/* A count that is held as a double. */
static int64_t counted(const adaptrack_block *b, uint32_t array, int64_t field) {
    const double value = entry_of(b, array, field).number;
    return value >= 0.0 && value < 1e6 && value == (double)(int64_t)value ? (int64_t)value : -1;
}

/* Every array of the MPC has the sizes that its kernel asks for. */
static adaptrack_error check_mpc_sizes(const adaptrack_block *b) {
    content settings[ADAPTRACK_MPC_SETTINGS], counts[ADAPTRACK_MPC_COUNTS];
    int64_t table[ADAPTRACK_MPC_ARRAYS][ADAPTRACK_SIZES];
    static const uint32_t PARTS[] = {ADAPTRACK_AT_STATES,    ADAPTRACK_AT_PARAMETERS, ADAPTRACK_AT_TURNING, 0,
                                     ADAPTRACK_AT_ESTIMATOR, ADAPTRACK_AT_ESTIMATES,  ADAPTRACK_AT_LEARNER, ADAPTRACK_AT_FRESH};
    for (uint32_t i = 0; i < ADAPTRACK_MPC_SETTINGS; i++) settings[i] = word_at(b, ADAPTRACK_MPC_SETTINGS_AT + i);
    counts[0].whole = 1;
    for (uint32_t i = 0; i < 8; i++) {
        counts[1 + i].whole = size_of(b, PARTS[i], array_of(PARTS[i])->sizes - 1u);
        BOUND(within(counts[1 + i].whole, 0, MOST_WORDS));
    }
    counts[4] = entry_of(b, ADAPTRACK_AT_TURNING, ADAPTRACK_TURNING_LAG);
    if (size_of(b, ADAPTRACK_AT_TURNING, 0) == 0) counts[4].number = 0.0;
    BOUND(counts[4].number >= 0.0 && counts[4].number <= ADAPTRACK_LONGEST_LAG);
    counts[9].whole = 1;
    BOUND(adaptrack_mpc_sizes(settings, counts, table[0], ADAPTRACK_MPC_ARRAYS, ADAPTRACK_SIZES) == ADAPTRACK_MPC_ARRAYS);
    for (uint32_t i = 0; i < ADAPTRACK_MPC_SETTINGS; i++)
        BOUND(settings[i].bits == word_at(b, ADAPTRACK_MPC_SETTINGS_AT + i).bits);
    for (uint32_t i = 0; i < ADAPTRACK_MPC_ARRAYS; i++)
        for (uint32_t k = 0; k < array_of(ADAPTRACK_AT_MPC + i)->sizes; k++)
            BOUND(size_of(b, ADAPTRACK_AT_MPC + i, k) == table[i][k]);
    BOUND(size_of(b, ADAPTRACK_AT_ANSWER, 0) == 1);
    BOUND(size_of(b, ADAPTRACK_AT_ANSWER, 1) == size_of(b, ADAPTRACK_AT_MPC_ANSWER, 1));
    return ADAPTRACK_OK;
}

/* What was learned: samples that may be missing, then commands and hypotheses that may not. */
static adaptrack_error check_learned(const adaptrack_block *b, int64_t commands, int64_t hypotheses) {
    adaptrack_cursor r = adaptrack_block_from(b, place_of(b, ADAPTRACK_AT_FRESH) + ADAPTRACK_LEARNED_LEAST);
    BOUND(within(counted(b, ADAPTRACK_AT_FRESH, ADAPTRACK_LEARNED_STATE), 0, ADAPTRACK_MOST_STATE));
    BOUND(within(counted(b, ADAPTRACK_AT_FRESH, ADAPTRACK_LEARNED_AT_BOUND), 0, ADAPTRACK_MOST_BOUND));
    for (int64_t i = commands + hypotheses * ADAPTRACK_LEARNED_HYPOTHESIS; i > 0; i--) {
        content found;
        found.bits = adaptrack_block_next(&r);
        BOUND(found.number == found.number);
    }
    for (int64_t i = 0; i < hypotheses; i++) {
        const int64_t at = ADAPTRACK_LEARNED_LEAST + commands + i * ADAPTRACK_LEARNED_HYPOTHESIS;
        const double dead_time = entry_of(b, ADAPTRACK_AT_FRESH, at + ADAPTRACK_HYPOTHESIS_DEAD_TIME).number;
        BOUND(dead_time >= 0.0 && dead_time <= ADAPTRACK_LONGEST_LAG);
    }
    return ADAPTRACK_OK;
}

/* Estimator and learner remember as much as their own counts ask for. */
static adaptrack_error check_memories(const adaptrack_block *b) {
    const int64_t late = entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_LATE_AT).whole;
    const int64_t filtered = entry_of(b, ADAPTRACK_AT_SETTINGS, ADAPTRACK_FILTERED_AT).whole;
    const int64_t beliefs = size_of(b, ADAPTRACK_AT_LEARNER, 0) > 0 ? ADAPTRACK_MPC_ANSWER : 0;
    BOUND(word_at(b, ADAPTRACK_TAKES_LATE_AT).whole == (filtered ? late : -1));
    BOUND(word_at(b, ADAPTRACK_BELIEFS_AT).whole == beliefs);
    for (int64_t i = 0; i < size_of(b, ADAPTRACK_AT_STATES, 0); i++)
        BOUND(within(entry_of(b, ADAPTRACK_AT_STATES, i).whole, 0, ADAPTRACK_MEASURED - 1));
    if (size_of(b, ADAPTRACK_AT_ESTIMATOR, 0) > 0) {
        const int64_t longest = counted(b, ADAPTRACK_AT_ESTIMATOR, ADAPTRACK_ESTIMATOR_LONGEST);
        const int64_t again = counted(b, ADAPTRACK_AT_ESTIMATOR, ADAPTRACK_ESTIMATOR_LATE);
        const double share = entry_of(b, ADAPTRACK_AT_ESTIMATOR, ADAPTRACK_ESTIMATOR_SHARE).number;
        BOUND(within(counted(b, ADAPTRACK_AT_ESTIMATOR, ADAPTRACK_ESTIMATOR_PERIODS), 0, longest) && late == again);
        BOUND(share >= 0.0 && share < 1.0);
        BOUND(size_of(b, ADAPTRACK_AT_ESTIMATES, 1) == ADAPTRACK_ESTIMATES_LEAST + longest * ADAPTRACK_ESTIMATES_LONGEST +
                                                           again * ADAPTRACK_ESTIMATES_LATE);
    }
    if (size_of(b, ADAPTRACK_AT_LEARNER, 0) > 0) {
        const int64_t commands = counted(b, ADAPTRACK_AT_LEARNER, ADAPTRACK_LEARNER_COMMANDS);
        const int64_t hypotheses = counted(b, ADAPTRACK_AT_LEARNER, ADAPTRACK_LEARNER_HYPOTHESES);
        BOUND(commands >= 2 && hypotheses >= 1);
        BOUND(size_of(b, ADAPTRACK_AT_FRESH, 0) ==
              ADAPTRACK_LEARNED_LEAST + commands + hypotheses * ADAPTRACK_LEARNED_HYPOTHESIS);
        return check_learned(b, commands, hypotheses);
    }
    return ADAPTRACK_OK;
}

/* Learning begins with what the block says, and a reset asks for the model anew. */
static adaptrack_error check_starts(const adaptrack_block *b) {
    const uint64_t count = words_of(b, ADAPTRACK_AT_FRESH);
    adaptrack_cursor fresh = adaptrack_block_from(b, place_of(b, ADAPTRACK_AT_FRESH));
    adaptrack_cursor learned = adaptrack_block_from(b, place_of(b, ADAPTRACK_AT_LEARNED));
    BOUND(b->starts == (count > 0) && b->resets == 1);
    BOUND(adaptrack_block_number(b->reset, 0) == place_of(b, ADAPTRACK_AT_MEMORY) + ADAPTRACK_RESET_AT);
    BOUND(adaptrack_block_number(b->reset, 1) == 0 && adaptrack_block_number(b->reset, 2) == 0);
    BOUND(adaptrack_block_number(b->reset, 3) == 0x7ff80000u);
    if (count == 0) return ADAPTRACK_OK;
    BOUND(adaptrack_block_number(b->start, 0) == place_of(b, ADAPTRACK_AT_LEARNED));
    BOUND(adaptrack_block_number(b->start, 1) == count);
    BOUND(adaptrack_block_number(b->start, 2) == place_of(b, ADAPTRACK_AT_FRESH));
    for (uint64_t i = 0; i < count; i++) BOUND(adaptrack_block_next(&fresh) == adaptrack_block_next(&learned));
    return ADAPTRACK_OK;
}

/* M of the QP follows from the moves. */
static adaptrack_error check_rows(const adaptrack_block *b) {
    const int64_t horizon = word_at(b, ADAPTRACK_MPC_LONGEST_HORIZON).whole, most = word_at(b, ADAPTRACK_MPC_MOST_MOVES).whole;
    const int64_t samples = most < horizon ? most : horizon, laguerre = word_at(b, ADAPTRACK_MPC_LAGUERRE).whole;
    const int64_t columns = laguerre ? word_at(b, ADAPTRACK_MPC_TERMS).whole : samples;
    const int64_t length = size_of(b, ADAPTRACK_AT_ROWS, 2), steps = size_of(b, ADAPTRACK_AT_MOVES, 1);
    for (int64_t c = 0; c < columns; c++) {
        adaptrack_cursor row = adaptrack_block_from(b, place_of(b, ADAPTRACK_AT_ROWS) + (uint32_t)(c * length));
        double angle = 0.0;
        for (int64_t i = 0; i < samples; i++) {
            const double move = laguerre ? entry_of(b, ADAPTRACK_AT_MOVES, c * steps + i).number : (c == i ? 1.0 : 0.0);
            const double expected[ADAPTRACK_ROWS] = {move, -move, angle + move, -(angle + move)};
            for (int k = 0; k < ADAPTRACK_ROWS; k++) {
                content found;
                found.bits = adaptrack_block_next(&row);
                BOUND(found.number == expected[k]);
            }
            angle += move;
        }
    }
    return ADAPTRACK_OK;
}

static adaptrack_error check_controller(const adaptrack_block *b) {
    adaptrack_error error = check_mpc_sizes(b);
    if (error == ADAPTRACK_OK) error = check_rows(b);
    if (error == ADAPTRACK_OK) error = check_memories(b);
    return error == ADAPTRACK_OK ? check_starts(b) : error;
}
#else
static adaptrack_error check_controller(const adaptrack_block *b) {
    return b->starts == 0 && b->resets == 0 ? ADAPTRACK_OK : ADAPTRACK_DAMAGED;
}
#endif

adaptrack_error adaptrack_check_bounds(const adaptrack_block *b) {
    uint32_t learned = 0, end = 0;
    adaptrack_error error = check_places(b);
    if (error == ADAPTRACK_OK) error = check_links(b);
    if (error == ADAPTRACK_OK) error = check_numbers(b);
    if (error == ADAPTRACK_OK) error = check_car(b);
    if (error == ADAPTRACK_OK) error = check_controller(b);
    if (error == ADAPTRACK_OK) error = check_schedule(b);
#if ADAPTRACK_OF_MPC
    if (error == ADAPTRACK_OK) {
        learned = place_of(b, ADAPTRACK_AT_LEARNED);
        end = learned + (uint32_t)words_of(b, ADAPTRACK_AT_LEARNED);
    }
#endif
    return error == ADAPTRACK_OK ? check_state(b, learned, end) : error;
}
