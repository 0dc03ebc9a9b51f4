"""Turns a tree of the Hoi! layout that write_hoi.py wrote (unzipped) into the same recording in another style.

usage: restyle_hoi.py FROM TO LOCATION RANGE NEW_LOCATION NEW_RANGE

What else may differ between two trees of one layout: line ends, quotes, the order of columns and columns that nobody asked for, rows
out of order, a byte order mark, how Kalibr's rows are broken, which of its two files holds the chain, and which folders are zipped at
which level. The standard library only.
"""
import csv
import io
import json
import os
import sys
import zipfile

# What write_hoi.py leaves between the two clocks.
REST_NS = 3_200_000


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def written(rows, columns, extra):
    """Quoted, CRLF, `extra` columns between, the rows in another order."""
    text = io.StringIO()
    names = [name for column in columns for name in (f"{column}_{extra}", column)]
    writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\r\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([row.get(name, "n/a") for name in names])
    return text.getvalue().encode()


def packed(entries):
    """A zip of (name, bytes), with entries for the folders, as file managers make them."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        folders = {name.rsplit("/", 1)[0] + "/" for name, _ in entries if "/" in name}
        for folder in sorted(folders):
            archive.writestr(folder, b"")
        for name, content in entries:
            archive.writestr(name, content)
        archive.writestr("__MACOSX/._data.csv", b"\0\1\2")
    return data.getvalue()


def write(path, data):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as file:
        file.write(data)


def block(rows, indent):
    """Rows as nested dashes, one number a line."""
    lines = []
    for row in rows:
        for index, value in enumerate(row):
            lines.append(f"{indent}{'- - ' if index == 0 else '  - '}{value}")
    return "\r\n".join(lines) + "\r\n"


def chain(text, section, key):
    """The rows of SECTION's KEY of what write_hoi.py wrote."""
    part = text.split(f"{section}:\n", 1)[1].split(f"  {key}:\n", 1)[1]
    return [json.loads(line.strip()[2:]) for line in part.splitlines()[:4]]


def gyroscope(poses, late_ns):
    """Angular rate of the glasses at 100 Hz by the wrench's clock, in axes that nobody knows: x is where z was."""
    lines = ["timestamp,orientation.x,angular_velocity.z,angular_velocity.y,angular_velocity.x"]
    names = [f"q{axis}_world_device" for axis in "xyzw"]
    for at in range(5, len(poses) - 5, 10):
        (ax, ay, az, aw), (bx, by, bz, bw) = ([float(poses[at + side][name]) for name in names] for side in (-5, 5))
        seconds = (int(poses[at + 5]["timestamp"]) - int(poses[at - 5]["timestamp"])) * 1e-9
        # Imaginary part of the one's inverse times the other.
        turn = (
            aw * bx - ax * bw - ay * bz + az * by,
            aw * by - ay * bw - az * bx + ax * bz,
            aw * bz - az * bw - ax * by + ay * bx,
        )
        sign = 1 if aw * bw + ax * bx + ay * by + az * bz > 0 else -1
        x, y, z = (2 * sign * part / seconds for part in turn)
        stamp = int(poses[at]["timestamp"]) - late_ns
        lines.append(f"{stamp},0.0,{x:.9g},{-y:.9g},{z:.9g}")
    return ("\r\n".join(lines) + "\r\n").encode()


def main():
    source, target, location, span, new_location, new_span = sys.argv[1:7]
    old = f"{source}/extracted/{location}/gripper"
    bag, vrs = (f"{old}/{kind}/{location}_{span}_gripper_{end}" for kind, end in (("gripper", "bag"), ("aria_gripper", "vrs")))
    new = f"{target}/extracted/{new_location}/gripper"
    new_bag = f"{new}/gripper/{new_location}_{new_span}_gripper_bag"
    new_vrs = f"{new}/aria_gripper/{new_location}_{new_span}_gripper_vrs"

    poses = table(f"{vrs}/slam/closed_loop_trajectory/data.csv")
    # The whole force_torque folder in one zip, and in it the stream zipped again; the wrench after the dataset's own processing.
    wrench = table(f"{bag}/force_torque/ft_sensor0/ft_sensor_readings/wrench/data.csv")
    axes = [f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz"]
    for row in wrench:
        for axis in axes:
            row[axis.replace("wrench", "wrench_ext") + "_filt"] = "0.0"
    broken = dict(wrench[7], timestamp=str(int(wrench[7]["timestamp"]) + 1), **{axes[0]: "nan"})
    wrench_csv = written(
        wrench[1000:] + [broken, wrench[5]] + wrench[:1000],
        axes[3:] + [axis.replace("wrench", "wrench_ext") + "_filt" for axis in axes] + axes[:3] + ["timestamp"],
        "raw",
    )
    stream = packed([("wrench/data.csv", b"\xef\xbb\xbf" + wrench_csv)])
    write(
        f"{new_bag}/force_torque.zip",
        packed([
            ("force_torque/ft_sensor0/ft_sensor_readings/wrench.zip", stream),
            ("force_torque/ft_sensor0/ft_sensor_readings/imu/data.csv", gyroscope(poses, REST_NS)),
        ]),
    )
    # The glasses: slam zipped, in it the trajectory and the aligned one, which is another world and not what is asked for.
    columns = [name for name in poses[0] if name != "timestamp"][::-1] + ["timestamp"]
    poses_csv = written(poses, columns, "x")
    other = written([dict(row, tx_world_device="1e3") for row in poses], columns, "x")
    write(
        f"{new_vrs}/slam.zip",
        packed([
            ("slam/closed_loop_trajectory_aligned/data.csv", other),
            ("slam/closed_loop_trajectory.zip", packed([("closed_loop_trajectory/data.csv", poses_csv)])),
        ]),
    )
    # The camchain has intrinsics only; the imucam file has the chain. Numbers as Python prints them, one a line, CRLF.
    with open(f"{bag}/calib/gripper-camchain.yaml") as file:
        cameras = file.read()
    with open(f"{bag}/calib/gripper-imu.yaml") as file:
        inertial = file.read()
    camchain = "".join(f"cam{k}:\r\n  camera_model: pinhole\r\n  intrinsics: [1, 2, 3, 4]\r\n" for k in range(3))
    imucam = "%YAML 1.1\r\n---\r\n" + "".join(
        f"cam{k}:\r\n  T_cam_imu:\r\n{block(chain(cameras, f'cam{k}', 'T_cam_imu'), '  ')}  camera_model: pinhole\r\n" for k in range(3)
    )
    imu = "imu0:\r\n  T_i_tool: " + json.dumps(chain(inertial, "imu0", "T_i_tool")) + "   # by CAD\r\n" + "".join(
        f"  {key}:\r\n{block(chain(inertial, 'imu0', key), '  ')}" for key in ("T_i_b", "T_i_s")
    ) + "  update_rate: 100.0\r\n"
    write(
        f"{new_bag}/calib.zip",
        packed([
            ("calib/2024-05-20-camchain.yaml", camchain.encode()),
            ("calib/2024-05-20-imucam.yaml", imucam.encode()),
            ("calib/2024-05-20-imu.yaml", imu.encode()),
        ]),
    )
    with open(f"{vrs}/calib/calib.json", "rb") as file:
        write(f"{new_vrs}/calib/calib.json", b"\xef\xbb\xbf" + file.read())


main()
