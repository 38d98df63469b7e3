/* adaptrack: a controller that makes a car follow a path. Samples in, commands and statuses out.

   SI units, angles in rad; axes and signs are those of ISO 8855: x forward, y left, yaw and steering positive to the
   left. A number that is not known is NaN. A tracker is memory of the caller, one for each car; nothing else is
   written, allocated or read. Calls on different trackers may run at the same time; a second one on the same tracker
   answers ADAPTRACK_BUSY. Arithmetic must round to nearest and have subnormal numbers, as processors begin. A file that
   includes this header does not compile with -Ofast or -ffast-math. A program linked with them may switch subnormal
   numbers off: adaptrack_init, _path, _engage, _follow, _step and _predicted_path then return ADAPTRACK_ARITHMETIC. */
#ifndef ADAPTRACK_H
#define ADAPTRACK_H
#include "adaptrack_config.h" /* ADAPTRACK_SIZE, _STATE_SIZE (bytes), _PERIOD (s), _MOST_POINTS, _VERSION, constants */
#include "adaptrack_error.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* -- the tracker -------------------------------------------------------------------------------------------------- */
#define ADAPTRACK_ALIGNMENT 64 /* bytes: fastest; a multiple of 8 does */
#if defined(__GNUC__)
#define ADAPTRACK_ALIGNED __attribute__((aligned(ADAPTRACK_ALIGNMENT)))
#elif defined(_MSC_VER)
#define ADAPTRACK_ALIGNED __declspec(align(64))
#else
#define ADAPTRACK_ALIGNED
#endif
typedef ADAPTRACK_ALIGNED struct {
    uint64_t memory[ADAPTRACK_SIZE / 8];
} adaptrack_tracker;

/* Bytes of memory of a tracker; 0 for damaged constants, and for those of another version. */
size_t adaptrack_size(const void *constants, size_t size);
/* Make a tracker of constants: before its first call, without a path. Nothing is written unless they are whole, of this
   version and layout, and within their bounds. The constants may be thrown away afterwards. */
adaptrack_error adaptrack_init(void *tracker, size_t tracker_size, const void *constants, size_t size);
/* Other constants, such as another tuning or learned car, from the next control instant on, without a bump: position,
   estimate and command go on. What was learned stays, unless the constants begin with another learned car.
   ADAPTRACK_OTHER_SIZES where their horizons or parts are others: they need their own export. Nothing changes unless
   the constants are verified as by adaptrack_init. */
adaptrack_error adaptrack_load(void *tracker, const void *constants, size_t size);
/* Begin anew from the angle that the wheels have (rad): the first command is near it. `near` (m, along the path): the
   car is looked for within 400 m of it; NaN: on the whole path, which takes longer. What was learned stays, as it does
   not in adaptrack_init; what was said of the inputs is forgotten. */
adaptrack_error adaptrack_engage(void *tracker, double wheel_angle, double near);

/* -- a path ------------------------------------------------------------------------------------------------------- */
/* Bytes of memory for a path through points x, y (m), one behind the other: points[0], points[1] are the first.
   0 for fewer than four points, or more than ADAPTRACK_MOST_POINTS (100,000). */
size_t adaptrack_path_size(const double *points, size_t count, int closed);
/* Make a path of the centre of mass through points, in memory of the caller that is aligned to 8 bytes: a cubic spline,
   its curvature continuous; a lap if `closed`. `noise`: standard deviation (m) of x and y, which is smoothed first; 0: the path goes
   through the points; NaN: estimated, 0 for points on a smooth curve and for fewer than 16. Points in a row count as one, the first, if their distance is at most a
   tenth of the step on either side and 0.2 m: such a step would turn the path by the error of its points.
   ADAPTRACK_TOO_SMALL for the memory. ADAPTRACK_BAD_PATH for fewer than four points, for more than
   ADAPTRACK_MOST_POINTS (100,000; `flaw` is then their count), and for a point that is not finite or makes a kink;
   `flaw`, unless null, is then the number of the point. */
adaptrack_error adaptrack_path(const double *points, size_t count, int closed, double noise, void *path,
                               size_t path_size, size_t *flaw);
/* m; NaN for no path */
double adaptrack_path_length(const void *path);
/* 1/m, positive to the left: the mean over the half metre of a path in which an arc length (m) lies; NaN for no path */
double adaptrack_path_curvature(const void *path, double s);

#if !ADAPTRACK_SPEED_CONTROL
/* A planned speed along a path: s (m) from 0 upwards to its length, speed (m/s). Arrays of the caller.
   ADAPTRACK_BAD_ARGUMENT for more than ADAPTRACK_MOST_POINTS. */
typedef struct {
    const double *s;
    const double *speed;
    size_t count; /* 0: no plan; the present speed is expected to stay */
} adaptrack_plan;

/* Follow a path from the next control instant on: it and the plan must stay as they are while they are followed.
   `near` (m): along the path, within 400 m of which the car is; NaN: anywhere, which takes longer. What was learned
   stays. Begin a path behind the car, by the age of the oldest samples at least. `plan` may be null. */
adaptrack_error adaptrack_follow(void *tracker, const void *path, double near, const adaptrack_plan *plan);
#else
/* -- a plan of the speed ------------------------------------------------------------------------------------------ */
/* A quantity along a path at ascending s (m): straight lines in between, constant before the first place and after the
   last one. Arrays of the caller. count 0: zero everywhere. */
typedef struct {
    const double *s;
    const double *value;
    size_t count;
} adaptrack_along;

/* What the car shall drive along a path. Arrays of the caller, which adaptrack_speed_plan copies. */
typedef struct {
    const double *s;       /* m, from 0 upwards to the path's length */
    const double *speed;   /* m/s, at most ADAPTRACK_TOP_SPEED; between two places its square is straight. It may stay
                              above 0 at a stop. It is 0 only within 0.5 m of a stop, and at the ends of an open path. */
    size_t count;          /* of s and speed, at least 2 */
    adaptrack_along grade; /* dz/ds, positive uphill, at most 0.4 to either side */
    adaptrack_along bank;  /* rad, positive where gravity pulls to the left, at most 1.4 to either side */
    const double *stops;   /* m, ascending, where the car stops */
    const double *seconds; /* s, how long it stands there; INFINITY: until adaptrack_release */
    size_t stop_count;
    int stays_at_end;      /* 1: the car stops at the end of an open path and stays, as after a last speed of 0 */
} adaptrack_speeds;

typedef enum {
    ADAPTRACK_PLAN_NO_FLAW = 0,
    ADAPTRACK_PLAN_SPEEDS = 1, /* s or speed */
    ADAPTRACK_PLAN_GRADE = 2,
    ADAPTRACK_PLAN_BANK = 3,
    ADAPTRACK_PLAN_STOPS = 4   /* stops or seconds */
} adaptrack_plan_array;

/* Which entry of which array makes no plan. */
typedef struct {
    adaptrack_plan_array array;
    size_t index;
} adaptrack_flaw;

/* Bytes of memory for a plan along a path; 0 for no path, or more than ADAPTRACK_MOST_POINTS entries. */
size_t adaptrack_speed_plan_size(const void *path, const adaptrack_speeds *speeds);
/* Make a plan along a path, in memory of the caller that is aligned to 8 bytes: at places half a metre apart the speed,
   the slope, the bank, and the curvature of the path. ADAPTRACK_BAD_PLAN where an entry is not possible; `flaw`, unless
   null, then says which one. The size of the memory grows with the length of the path, by 64 bytes a metre. */
adaptrack_error adaptrack_speed_plan(const void *path, const adaptrack_speeds *speeds, void *plan, size_t plan_size,
                                     adaptrack_flaw *flaw);
/* Follow a path and a plan along it from the next control instant on: both must stay as they are while they are
   followed. `near` (m): along the path, within 400 m of which the car is; NaN: anywhere, which takes longer. What was
   learned stays, and so do a stop at which the car stands and the time there: the stops of both plans are compared by
   their places in x and y. Begin a path behind the car, by the age of the oldest samples at least. ADAPTRACK_BAD_PLAN
   for a plan of a different path, or faster than ADAPTRACK_TOP_SPEED. */
adaptrack_error adaptrack_follow_plan(void *tracker, const void *path, double near, const void *plan);
/* Let the car leave the stop at which it stands, whatever its time; at the end of a path it stays. */
adaptrack_error adaptrack_release(void *tracker);
/* End a brake or drive fault, and the distrust of a speed that contradicted the positions, as a driver at the pedals
   does: the car drives on. Call it only when you know that the car is in order. */
adaptrack_error adaptrack_acknowledge_fault(void *tracker);
#endif

/* -- a call ------------------------------------------------------------------------------------------------------- */
typedef struct {
@SAMPLE@
} adaptrack_sample;
#define ADAPTRACK_UNKNOWN {@UNKNOWN@}

/* What a call was. */
typedef enum {
@STATUSES@
} adaptrack_status;

typedef struct {
@ANSWER@
#if ADAPTRACK_PLANNER && !ADAPTRACK_SPEED_CONTROL
    double target_speed; /* m/s, planned one period ahead by the times; NaN without a trajectory or a position */
#endif
#if ADAPTRACK_SPEED_CONTROL
    /* Requests of the speed control for the present period. Pass on `force` or `acceleration`, not both, and `hold`.
       They are finite, and within the limits of the car, whatever a sample contains. The force is for a car of
       ADAPTRACK_MASS; its limits of friction do not adapt to a different mass. */
@REQUESTS@
#endif
} adaptrack_answer;

#if ADAPTRACK_SPEED_CONTROL
/* Who brakes, and when:
   answer of adaptrack_step                 requests of the speed control                     your program
   OK, with a status below                  by the status                                     passes them on
   OK, status REPEATED or NO_TIME           the same as before; for long: see `none`          passes them on
   OK, sample.driver is 1                   those that the car has by its driver; DRIVER      lets the driver drive
   an error; or you cannot call             none: the answer is not written                   brakes by itself
@ACTIONS@
   follow: the plan and its stops. slow: the same, but the car stands before the steering loses its estimate. comfort
   stop: with the deceleration of comfort. emergency stop: as hard as the assumed friction allows. Both keep the car at
   rest by `hold`. none: the requests stay; for longer than 0.5 s, by the usual time between two calls, the car stops
   before the steering loses its estimate. A position counts as missing 0.5 s after the last one, and so does a speed:
   without a speed, or with one that contradicts the positions, the car makes a comfort stop.
   Order of precedence: fault, driver, blind, grip, stop, speed limit, comfort. */
#endif

/* One call, at any time: a control instant is one period after the other, and a call belongs to the nearest. A number
   beyond what a car can have counts as not known. ADAPTRACK_OUT_OF_ORDER before there is a path, ADAPTRACK_BAD_PATH
   when its memory was overwritten. Where this does not answer ADAPTRACK_OK, the answer is not written. */
adaptrack_error adaptrack_step(void *tracker, const adaptrack_sample *sample, adaptrack_answer *answer);

/* Where the controller intends to go, as of the last control instant: `points`, x and y (m) one behind the other, are
   where it expects the centre of mass, in the axes of the path. The first point is `first` (s) after that instant, one
   period behind the dead time, and the others follow every ADAPTRACK_PERIOD. `room`: of points, for which there is
   memory; ADAPTRACK_TOO_SMALL where it is less than `count`, nothing written; ADAPTRACK_HORIZON is enough. `count` is 0
   without a prediction: the controller is no MPC (ADAPTRACK_HORIZON is 0), there was no control instant on this path
   with these constants yet, or the last one found no solution. Errors as of adaptrack_step. */
adaptrack_error adaptrack_predicted_path(void *tracker, double *points, size_t room, size_t *count, double *first);

#if ADAPTRACK_PLANNER
/* -- a planner's trajectories ------------------------------------------------------------------------------------- */
/* A point of a trajectory. NaN: not given; so is a quantity that is 0 at all points. */
typedef struct {
@POINT@
} adaptrack_point;

/* Where the car is to be, and when. Arrays of the caller, which are copied. */
typedef struct {
    const adaptrack_point *points;
    size_t count;  /* at most ADAPTRACK_TRAJECTORY_POINTS; 0: the planner is silent */
    double stamp;  /* s, on the planner's clock, from which its times count; 0: the time of arrival */
    double now;    /* s, when it arrived, on the clock of adaptrack_step; NaN: at the time of the last call */
    int is_urgent; /* 1: it counts at once, without a transition */
} adaptrack_trajectory;

/* Give a tracker memory for trajectories, aligned to 8 bytes and of ADAPTRACK_PLANNER_SIZE: once, behind adaptrack_init.
   It must stay as it is until the tracker is initialised again. ADAPTRACK_OUT_OF_ORDER while a trajectory is followed.
   */
adaptrack_error adaptrack_planner(void *tracker, void *memory, size_t size);
/* Follow a trajectory, wherever it begins: it is joined to what is followed, and followed by its times. A path in
   between (adaptrack_follow) ends that. `verdict` says what became of it. `fallback`, unless null, must end at rest; it
   is kept with a trajectory that is TAKEN or the SAME until another one comes, and its `now` is not read.
   ADAPTRACK_BAD_TRAJECTORY where the trajectory is not possible, ADAPTRACK_BAD_FALLBACK where the fallback is not:
   `flaw`, unless null, is then the number of the point. ADAPTRACK_TOO_SMALL for more points, or a way of more than about
   1,000 m. ADAPTRACK_BAD_PLAN where it is faster than ADAPTRACK_TOP_SPEED of a speed control. ADAPTRACK_OUT_OF_ORDER
   without memory, or without a time: neither `now` nor a call. The car goes on as before after an error. */
adaptrack_error adaptrack_follow_trajectory(void *tracker, const adaptrack_trajectory *trajectory,
                                            const adaptrack_trajectory *fallback, adaptrack_verdict *verdict,
                                            size_t *flaw);
/* Who drives, `driven_by` of an answer; adaptrack_step goes over to the fallback by itself:
@WHO_DRIVES@
   silence: none was TAKEN or the SAME for `Following.silence`. valid: younger than `fallback_age`, and it begins at the
   car. stop: a speed control stops the car; without one your program does. The driver comes before the fallback, and
   that before the planner.
   A saved state does not hold the trajectory and its fallback. adaptrack_restore answers ADAPTRACK_OTHER_PATH unless the
   tracker follows the same trajectory, joined in the same way; a fallback stays as the tracker has it. */
#endif

/* -- the state ---------------------------------------------------------------------------------------------------- */
/* Bytes of a saved state; 0 for no tracker. */
size_t adaptrack_state_size(const void *tracker);
/* Save all that changes. */
adaptrack_error adaptrack_save(void *tracker, void *state, size_t size);
/* Go on from a saved state, to the bit: of the same version, under the same constants, on the same path. Nothing
   changes unless it is proved. */
adaptrack_error adaptrack_restore(void *tracker, const void *state, size_t size);

/* "0.3.0 kernels 0123456789abcdef": constants and states need the same kernels. */
const char *adaptrack_version(void);
/* The name of an error, such as "ADAPTRACK_DAMAGED". */
const char *adaptrack_error_name(adaptrack_error error);

#ifdef __cplusplus
}
#endif
#endif
