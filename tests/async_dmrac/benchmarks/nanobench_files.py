"""Files in the format of NanoBench, of a flight by a known law.

A vehicle with a linear drag flies a path; its motors follow their commands with a lag; the battery empties. The onboard
columns are LATE_ROWS late. Their filter is off by a known velocity and rotation.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from protocol.conventions import GRAVITY, Array

HEADER = (
    "t,px,py,pz,qx,qy,qz,qw,roll,pitch,yaw,vx,vy,vz,wx_vicon,wy_vicon,wz_vicon,imu_acc_x,imu_acc_y,imu_acc_z,"
    "imu_gyro_x,imu_gyro_y,imu_gyro_z,motor_motor_m1,motor_motor_m2,motor_motor_m3,motor_motor_m4,"
    "est_stateEstimate_x,est_stateEstimate_y,est_stateEstimate_z,est_stateEstimate_vx,est_stateEstimate_vy,"
    "est_stateEstimate_vz,est_stateEstimate_ax,est_stateEstimate_ay,est_stateEstimate_az,att_stateEstimate_roll,"
    "att_stateEstimate_pitch,att_stateEstimate_yaw,att_stateEstimate_qx,att_stateEstimate_qy,att_stateEstimate_qz,"
    "att_stateEstimate_qw,sp_ctrltarget_x,sp_ctrltarget_y,sp_ctrltarget_z,sp_ctrltarget_yaw,pid_controller_roll,"
    "pid_controller_pitch,pid_controller_yaw,pid_controller_cmd_thrust,pwr_pm_vbat"
)
DT = 0.01
STILL_S = 4.0
LATE_ROWS = 3
MOTOR_LAG_S = 0.03
K = np.array([1.0, 0.5, 0.4])
"""Thrust per unit of mass over the squared commands: 1, V, V^2."""
DRAG = np.array([0.5, 0.8, 0.05])
"""1/s."""
EKF_OFF_M_S = np.array([0.1, -0.2, 0.2])
EKF_OFF_DEG = 2.0


def velocity_of(time_s: Array, seed: int) -> tuple[Array, Array]:
    """[n, 3] position and velocity, m and m/s, z up, on a fine grid: at rest for STILL_S, then up, then about."""
    t = np.maximum(time_s - STILL_S, 0.0)
    share = np.clip(t / 3.0, 0.0, 1.0)
    rise = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # smooth to the second derivative
    phase = 0.7 * seed
    x = 0.6 * rise * (np.cos(1.9 * t + phase) - np.cos(phase))
    y = 0.8 * rise * np.sin(1.3 * t + phase) + 0.1
    z = 0.07 + rise * (1.0 + 0.12 * np.sin((5.5 + 0.2 * seed) * t))
    position = np.column_stack([x, y, z])
    return position, np.gradient(position, time_s, axis=0)


def write_flight(path: Path, seed: int, seconds: float = 16.0) -> dict[str, Array]:
    """Write a flight; returns its true rows by name."""
    rng, steps = np.random.default_rng(seed), 10
    fine = np.arange(round(seconds / DT) * steps) * DT / steps
    position, velocity = velocity_of(fine, seed)
    acceleration = np.gradient(velocity, fine, axis=0)
    force = acceleration + np.array([0.0, 0.0, GRAVITY])
    thrust = force + DRAG * velocity
    yaw = 0.4 + 0.8 * np.maximum(fine - STILL_S, 0.0) * np.clip((fine - STILL_S) / 5.0, 0.0, 1.0)
    up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    left = np.cross(up, np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw]))
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    turned = Rotation.from_matrix(np.stack([np.cross(left, up), left, up], axis=2))
    rates = (turned[:-1].inv() * turned[1:]).as_rotvec() / (fine[1] - fine[0])
    rates = np.vstack([rates, rates[-1:]])
    rows = slice(0, None, steps)
    n = len(fine[rows])
    battery = np.linspace(4.15, 3.7, n)
    flying = fine[rows] > STILL_S
    squares = np.linalg.norm(thrust[rows], axis=1) / (battery[:, None] ** np.arange(3) @ K)
    shares = 0.25 + 0.02 * np.column_stack([np.sin(k + 3.0 * fine[rows]) for k in range(3)])
    shares = np.column_stack([shares, 1.0 - shares.sum(axis=1)])
    speeds = np.sqrt(squares[:, None] * shares)
    keep = np.exp(-DT / MOTOR_LAG_S)
    commands = speeds.copy()
    commands[1:] = (speeds[1:] - keep * speeds[:-1]) / (1.0 - keep)
    commands = np.where(flying[:, None], commands, 0.0)
    q, v = turned[rows].as_quat(), velocity[rows]
    truth = {
        "t": 1772430159.18 + fine[rows],
        "position": position[rows] + 1e-4 * rng.standard_normal((n, 3)),
        "attitude": q,
        "velocity": v,
        "imu_g": turned[rows].inv().apply(force[rows]) / GRAVITY + 0.002 * rng.standard_normal((n, 3)),
        "gyro": rates[rows] + 0.003 * rng.standard_normal((n, 3)),
        "pwm": 65535.0 * commands,
        "ekf_velocity": v + EKF_OFF_M_S,
        "ekf_attitude": (turned[rows] * Rotation.from_euler("x", EKF_OFF_DEG, degrees=True)).as_quat(),
        "battery": battery,
    }
    late = {
        name: np.concatenate([values[:1].repeat(LATE_ROWS, axis=0), values[:-LATE_ROWS]])
        for name, values in truth.items()
    }
    none = np.zeros((n, 1))
    table = np.column_stack(
        [
            *(truth["t"], truth["position"], q, turned[rows].as_euler("xyz"), v, turned[rows].apply(rates[rows])),
            *(late["imu_g"], late["gyro"], late["pwm"], late["position"], late["ekf_velocity"], none.repeat(6, axis=1)),
            *(late["ekf_attitude"], none.repeat(8, axis=1), late["battery"]),
        ]
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, table, fmt="%.9f", delimiter=",", header=HEADER, comments="")
    return truth
