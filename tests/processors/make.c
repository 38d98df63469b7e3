/* A learning MPC of a car of which mass and wheelbase are known, made without Python: make ANSWERS. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "adaptrack.h"

#define NUMBERS(record) (double *)&(record), (int64_t)(sizeof(record) / 8)

static void say_nothing(void *record, size_t size) {
    for (size_t i = 0; i < size / 8; i++) ((double *)record)[i] = NAN;
}

int main(int count, char **names) {
    static struct adaptrack_synthesis_informed_Order order;
    static struct adaptrack_synthesis_informed_InformedParts parts;
    static struct adaptrack_synthesis_informed_Constants all;
    static struct adaptrack_controllers_mpc_MPCSettings settings;
    static double tuning[4], model[7], turning[7], estimator[100], learner[120], fresh[10000];
    static int64_t states[5];
    adaptrack_word sizes[3];
    FILE *answers = fopen(names[1], "wb");
    if (count != 2 || !answers) return 1;

    say_nothing(&order.car, sizeof order.car);
    order.car.mass = 1500.0;
    if (adaptrack_complete_car(2.7, 0.0, 0, &order.car, &order.within)) return 2;
    say_nothing(&order.caller, 3 * sizeof order.caller); /* nobody says anything of the steering */
    say_nothing(&order.start, sizeof order.start);
    order.world.period = 0.05;
    order.world.computation = 0.0;
    order.world.preview = 1;
    order.world.noise_vy = 0.05;
    order.world.noise_yaw = 0.003;
    order.world.noise_yaw_rate = 0.01;
    order.world.noise_y = 0.03;
    order.world.noise_wheel_angle = order.world.noise_lateral_acceleration = INFINITY;
    order.learning = 1;
    order.longest_horizon = 60;
    order.most_moves = 20;
    adaptrack_usual_method(NUMBERS(order.method));
    order.method.dead_times = 4.0;
    adaptrack_usual_filter(NUMBERS(parts.filter));

    if (adaptrack_informed_parts(&order, &parts)) return 3;
    adaptrack_informed_sizes(&order, &parts, sizes);
    all.settings = &settings, all.settings_size[0] = 1;
    all.tuning = tuning, all.tuning_size[0] = 4;
    all.model = model, all.model_size[0] = 7;
    all.states = states, all.states_size[0] = sizes[0].whole;
    all.turning = turning, all.turning_size[0] = 7;
    all.estimator = estimator, all.estimator_size[0] = 100;
    all.learner = learner, all.learner_size[0] = 120;
    all.fresh = fresh, all.fresh_size[0] = sizes[2].whole;
    if (adaptrack_informed_constants(&order, &parts, &all)) return 4;
    fwrite(tuning, 8, 4, answers);
    fwrite(model, 8, 7, answers);
    fwrite(turning, 8, 7, answers);
    fwrite(estimator, 8, 100, answers);
    fwrite(learner, 8, 120, answers);
    fwrite(fresh, 8, (size_t)sizes[2].whole, answers);
    return fclose(answers) != 0;
}
