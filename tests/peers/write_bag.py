"""Writes a ROS 1 bag as a Hoi! gripper does, with the rosbags library.

usage: write_bag.py SOURCE BAG [bz2]

SOURCE holds lines: ns fx fy fz tx ty tz wx wy wz.
"""
import sys
from pathlib import Path

import numpy
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
types = store.types
Stamped, Wrench, Vector, Header, Time, Temperature, Imu, Quaternion = (
    types[name]
    for name in (
        "geometry_msgs/msg/WrenchStamped",
        "geometry_msgs/msg/Wrench",
        "geometry_msgs/msg/Vector3",
        "std_msgs/msg/Header",
        "builtin_interfaces/msg/Time",
        "sensor_msgs/msg/Temperature",
        "sensor_msgs/msg/Imu",
        "geometry_msgs/msg/Quaternion",
    )
)
SENSOR = "/force_torque/ft_sensor0/ft_sensor_readings/"
source, bag = sys.argv[1:3]
writer = Writer(Path(bag))
if "bz2" in sys.argv[3:]:
    writer.set_compression(Writer.CompressionFormat.BZ2)
with writer:
    wrench = writer.add_connection(SENSOR + "wrench", Stamped.__msgtype__, typestore=store)
    warmth = writer.add_connection(SENSOR + "temperature", Temperature.__msgtype__, typestore=store)
    inertial = writer.add_connection(SENSOR + "imu", Imu.__msgtype__, typestore=store)
    for count, line in enumerate(open(source)):
        ns, *values = line.split()
        ns, values = int(ns), list(map(float, values))
        header = Header(seq=count, stamp=Time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id="ft_sensor0")
        message = Stamped(header=header, wrench=Wrench(force=Vector(*values[:3]), torque=Vector(*values[3:6])))
        writer.write(wrench, ns, store.serialize_ros1(message, Stamped.__msgtype__))
        if count % 100 == 0:
            message = Temperature(header=header, temperature=31.5, variance=0.0)
            writer.write(warmth, ns, store.serialize_ros1(message, Temperature.__msgtype__))
        if count % 5 == 0:
            unknown = numpy.zeros(9)
            message = Imu(
                header=header,
                orientation=Quaternion(0.0, 0.0, 0.0, 0.0),
                orientation_covariance=unknown - numpy.eye(9)[0],
                angular_velocity=Vector(*values[6:]),
                angular_velocity_covariance=unknown,
                linear_acceleration=Vector(0.0, 0.0, 9.81),
                linear_acceleration_covariance=unknown,
            )
            writer.write(inertial, ns, store.serialize_ros1(message, Imu.__msgtype__))
