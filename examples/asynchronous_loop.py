"""Sensors with their own rates: poses at 10 Hz that are 0.1 s old, yaw rate at 100 Hz, speed at 50 Hz, with noise."""

import numpy as np

import adaptrack as at

car, rng = at.load_vehicle("midsize-sedan"), np.random.default_rng(1)
road = at.generate_road("country", seed=1, length=900.0)
noise = at.SensorNoise(y=0.05, yaw=0.005, yaw_rate=0.003, vy=np.inf)  # m, rad, rad/s; v_y is not measured
sensors = at.KalmanFilter(noise=noise, oldest=0.25)  # s, accepted age of a pose
mpc = at.MPC(car, belief=at.Steering(lag=0.15, dead_time=0.0), computation=0.0, estimator=sensors)
tracker, start = at.Tracker(mpc, road), road.at(0.0)
x, y, yaw, wheels, true_speed = float(start.x), float(start.y), float(start.heading), 0.0, 15.0
poses, offsets, speed = [], [], true_speed
for k in range(4000):  # 40 s at 100 Hz, at the rate of the fastest sensor
    now, pose_time, pose = 0.01 * k, 0.01 * k, (np.nan, np.nan, np.nan)  # NaN: no new pose
    poses.append((x, y, yaw))
    yaw_rate = true_speed * np.tan(wheels) / car.wheelbase + rng.normal(0.0, 0.003)
    if k % 2 == 0:
        speed = true_speed + rng.normal(0.0, 0.1)
    if k % 10 == 0 and k >= 10:
        pose_time, pose = now - 0.1, np.add(poses[-11], rng.normal(0.0, (0.05, 0.05, 0.005)))
    out = tracker.step(pose_time, *pose, speed, yaw_rate, now=now, motion_time=now)
    # The car: replace the rest of the loop by yours. Its wheels lag by 0.15 s, and its tyres do not slip.
    wheels += (1.0 - np.exp(-0.01 / 0.15)) * (out.command - wheels)
    course = yaw + np.arctan(car.lr * np.tan(wheels) / car.wheelbase)
    x, y = x + 0.01 * true_speed * np.cos(course), y + 0.01 * true_speed * np.sin(course)
    yaw += 0.01 * true_speed * np.tan(wheels) / car.wheelbase
    offsets.append(float(road.project([x], [y]).offset[0]))
rms, largest = np.sqrt(np.mean(np.square(offsets))), np.abs(offsets).max()
print(f"{100.0 * rms:.1f} cm RMS, largest {100.0 * largest:.1f} cm, {out.status}, suspect: {len(out.suspect)}")
