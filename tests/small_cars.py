"""A linear car as a function of one's own, for the tests of user plants."""

import math

PARAMETERS = {"mass": 1575.0, "inertia": 2875.0, "lf": 1.2, "lr": 1.6, "cf": 19000.0, "cr": 33000.0, "wind": 5.0}


def linear_car(x, u, environment, p, dx):
    """Eq. (6), its wheels pushed by m, I_z, l_f, l_r, C_f, C_r, and a side wind of p[6] N per m/s."""
    speed = max(x[3], 1.0)
    front = 2.0 * p[4] * environment[0] * (u[0] - (x[4] + p[2] * x[5]) / speed)
    rear = -2.0 * p[5] * environment[2] * (x[4] - p[3] * x[5]) / speed
    dx[0] = x[3] * math.cos(x[2]) - x[4] * math.sin(x[2])
    dx[1] = x[3] * math.sin(x[2]) + x[4] * math.cos(x[2])
    dx[2] = x[5]
    dx[3] = u[1] / p[0] + x[4] * x[5]
    dx[4] = (front + rear + p[6] * environment[5]) / p[0] - x[3] * x[5]
    dx[5] = (p[2] * front - p[3] * rear) / p[1]
