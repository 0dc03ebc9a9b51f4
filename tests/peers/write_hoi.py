"""Writes one recording in the extracted layout of the public Hoi! dataset, from plain text files.

usage: write_hoi.py SOURCE BASE LOCATION RANGE [zip] [ppm=PPM]

SOURCE holds wrench.txt (ns fx fy fz tx ty tz), pose.txt (ns px py pz qx qy qz qw, world_from_aria_device) and frames.txt
(two lines px py pz qx qy qz qw: device_from_tool, tool_from_sensor). The standard library only.

The two devices' stamps are on one clock up to 3.2 ms of rest (and the glasses' clock is slow by PPM), the wrench comes at 100 Hz, and the way from the glasses to the
sensor goes over a camera and the sensor's inertial unit, whose poses are made up.
"""
import json
import math
import os
import random
import sys
import zipfile

REST_NS = 3_200_000
EPOCH_NS = 1_716_200_000_000_000_000


def rows(path):
    with open(path) as file:
        return [line.split() for line in file]


def matrix(pose):
    px, py, pz, x, y, z, w = map(float, pose)
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz],
        [0.0, 0.0, 0.0, 1.0],
    ]


def times(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(4)) for j in range(4)] for i in range(4)]


def inverse(a):
    turn = [[a[j][i] for j in range(3)] for i in range(3)]
    move = [-sum(turn[i][k] * a[k][3] for k in range(3)) for i in range(3)]
    return [turn[i] + [move[i]] for i in range(3)] + [[0.0, 0.0, 0.0, 1.0]]


def made_up(seed):
    numbers = random.Random(seed)
    quaternion = [numbers.gauss(0, 1) for _ in range(4)]
    length = math.sqrt(sum(q * q for q in quaternion))
    return matrix([numbers.uniform(-0.1, 0.1) for _ in range(3)] + [q / length for q in quaternion])


def yaml_rows(a, indent):
    return "".join(f"{indent}- [{', '.join(f'{value:.16g}' for value in row)}]\n" for row in a)


def write(path, text):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "w") as file:
        file.write(text)


def zipped(path, name, data, times_zipped):
    """PATH.zip with NAME, in a second zip when asked."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    if times_zipped == 1:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(name, data)
        return
    inner = path + ".inner"
    zipped(inner, name, data, times_zipped - 1)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(inner, os.path.basename(path))
    os.remove(inner)


def main():
    source, base, location, span = sys.argv[1:5]
    with_zips = "zip" in sys.argv[5:]
    slow_ppm = sum(int(word[4:]) for word in sys.argv[5:] if word.startswith("ppm="))
    wrench, poses = rows(f"{source}/wrench.txt"), rows(f"{source}/pose.txt")
    device_from_tool, tool_from_sensor = map(matrix, rows(f"{source}/frames.txt"))
    start = int(wrench[0][0])

    bag = f"{base}/extracted/{location}/gripper/gripper/{location}_{span}_gripper_bag"
    vrs = f"{base}/extracted/{location}/gripper/aria_gripper/{location}_{span}_gripper_vrs"

    # Ten samples of 1 kHz make one of 100 Hz, stamped in their middle.
    lines = ["timestamp,wrench.force.x,wrench.force.y,wrench.force.z,wrench.torque.x,wrench.torque.y,wrench.torque.z"]
    for at in range(0, len(wrench) - 9, 10):
        ten = wrench[at:at + 10]
        stamp = sum(int(row[0]) - start for row in ten) // 10 + EPOCH_NS
        means = [sum(float(row[k]) for row in ten) / 10 for k in range(1, 7)]
        lines.append(f"{stamp}," + ",".join(f"{value:.9g}" for value in means))
    wrench_csv = "\n".join(lines) + "\n"
    temperature_csv = "timestamp,temperature,variance\n" + "".join(
        f"{EPOCH_NS + second * 10**9},31.5,0.0\n" for second in range(0, 60)
    )
    readings = f"{bag}/force_torque/ft_sensor0/ft_sensor_readings"
    if with_zips:
        zipped(f"{readings}/wrench.zip", "wrench/data.csv", wrench_csv, 1)
        zipped(f"{readings}/temperature.zip", "temperature/data.csv", temperature_csv, 2)
    else:
        write(f"{readings}/wrench/data.csv", wrench_csv)
        write(f"{readings}/temperature/data.csv", temperature_csv)

    header = (
        "graph_uid,timestamp,utc_timestamp_ns,tx_world_device,ty_world_device,tz_world_device,qx_world_device,qy_world_device,"
        "qz_world_device,qw_world_device,gravity_x_world,gravity_y_world,gravity_z_world,quality_score"
    )
    lines = [header]
    for row in poses:
        since = int(row[0]) - start
        stamp = since - since * slow_ppm // 10**6 + EPOCH_NS + REST_NS
        values = ",".join(f"{float(value):.9f}" for value in row[1:])
        lines.append(f"ea7288b8-b6a0-012d-8156-257aba6bd796,{stamp},-1,{values},0.0,0.0,-9.81,1.0")
    trajectory_csv = "\n".join(lines) + "\n"
    if with_zips:
        zipped(f"{vrs}/slam/closed_loop_trajectory.zip", "closed_loop_trajectory/data.csv", trajectory_csv, 2)
    else:
        write(f"{vrs}/slam/closed_loop_trajectory/data.csv", trajectory_csv)

    # device_from_tool = device_from_camera camera_from_imu imu_from_tool
    device_from_camera, camera_from_imu = made_up(1), made_up(2)
    imu_from_device = inverse(times(device_from_camera, camera_from_imu))
    imu_from_tool = times(imu_from_device, device_from_tool)
    imu_from_sensor = times(imu_from_tool, tool_from_sensor)
    write(
        f"{bag}/calib/gripper-camchain-imucam.yaml",
        "# not the chain that is needed\ncam0:\n  T_cam_imu:\n" + yaml_rows(made_up(9), "  "),
    )
    os.rename(f"{bag}/calib/gripper-camchain-imucam.yaml", f"{bag}/calib/notes.yaml")
    write(
        f"{bag}/calib/gripper-camchain.yaml",
        "cam0:\n  T_cam_imu:\n" + yaml_rows(made_up(3), "  ") + "  cam_overlaps: [1, 2]\n"
        "cam1:\n  T_cam_imu:\n" + yaml_rows(made_up(4), "  ") + "  T_cn_cnm1:\n" + yaml_rows(made_up(5), "  ")
        + "cam2:\n  T_cam_imu:\n" + yaml_rows(camera_from_imu, "  ") + "  T_cn_cnm1:\n" + yaml_rows(made_up(6), "  ")
        + "  timeshift_cam_imu: 0.0123\n",
    )
    write(
        f"{bag}/calib/gripper-imu.yaml",
        "imu0:\n  T_i_b:\n" + yaml_rows(made_up(7), "  ") + "  T_i_s:\n" + yaml_rows(imu_from_sensor, "  ")
        + "  T_i_tool:\n" + yaml_rows(imu_from_tool, "  ") + "  rostopic: /force_torque/ft_sensor0/ft_sensor_readings/imu\n",
    )
    write(f"{vrs}/calib/calib.json", json.dumps({"PINHOLE": {"T_device_camera": made_up(8)},
                                                  "NON_PINHOLE": {"T_device_camera": device_from_camera}}))


main()
