/* Lets a tracker follow the path of the recorded drive, with its plan. */
#ifndef ADAPTRACK_REPLAY_H
#define ADAPTRACK_REPLAY_H
#include "adaptrack.h"
#include "adaptrack_recorded.h"

static adaptrack_error follow_recorded(void *tracker, const void *path) {
#if ADAPTRACK_SPEED_CONTROL
    static uint64_t plan[ADAPTRACK_RECORDED_SPEED_PLAN_SIZE / 8];
    const adaptrack_speeds speeds = {
        adaptrack_recorded_plan_s, adaptrack_recorded_plan_speed, ADAPTRACK_RECORDED_PLAN,
        {adaptrack_recorded_grade_s, adaptrack_recorded_grade, ADAPTRACK_RECORDED_GRADES}, {0, 0, 0},
        adaptrack_recorded_stops, adaptrack_recorded_seconds, ADAPTRACK_RECORDED_STOPS, ADAPTRACK_RECORDED_STAYS};
    adaptrack_error error = adaptrack_speed_plan(path, &speeds, plan, sizeof plan, 0);
    return error == ADAPTRACK_OK ? adaptrack_follow_plan(tracker, path, NAN, plan) : error;
#else
    const adaptrack_plan plan = {adaptrack_recorded_plan_s, adaptrack_recorded_plan_speed, ADAPTRACK_RECORDED_PLAN};
    return adaptrack_follow(tracker, path, NAN, &plan);
#endif
}
#endif
