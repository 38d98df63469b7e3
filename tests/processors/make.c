/* A learning MPC of a car of which mass and wheelbase are known, made without Python: make ANSWERS. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "adaptrack.h"

static void say_nothing(void *record, size_t size) {
    for (size_t i = 0; i < size / 8; i++) ((double *)record)[i] = NAN;
}

int main(int count, char **names) {
    static struct adaptrack_synthesis_mpc_Order order;
    static struct adaptrack_synthesis_mpc_MPCNumbers mpc;
    static double fresh[10000];
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
    adaptrack_usual_method(&order.method);
    order.method.dead_times = 4.0;

    if (adaptrack_informed_numbers(&order, &mpc)) return 3;
    adaptrack_learner_memory(&mpc.learner, &mpc.filter, fresh, mpc.learned);
    fwrite(mpc.tuning, sizeof mpc.tuning, 1, answers);
    fwrite(&mpc.model, sizeof mpc.model, 1, answers);
    fwrite(&mpc.turning, sizeof mpc.turning, 1, answers);
    fwrite(&mpc.estimator, sizeof mpc.estimator, 1, answers);
    fwrite(&mpc.learner.parameters, sizeof mpc.learner.parameters, 1, answers);
    fwrite(fresh, 8, (size_t)mpc.learned, answers);
    return fclose(answers) != 0;
}
