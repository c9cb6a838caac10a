#!/usr/bin/env python3
"""Reads a recorded run with the ROS 2 tools of MCAP; no ROS installation is needed.

    pip install mcap mcap-ros2-support
    rubik-robot run scenarios/solve.toml --record run.mcap
    python3 examples/read_run.py run.mcap
"""
import sys
from mcap_ros2.reader import read_ros2_messages

grip = {}
cube = "not known"
for message in read_ros2_messages(
    sys.argv[1], topics=["/phase", "/rosout", "/cube", "/track/servo"]
):
    seconds, ros = message.log_time_ns * 1e-9, message.ros_msg
    match message.channel.topic:
        case "/phase":
            print(f"{seconds:9.3f} s  {ros.name} {ros.outcome}")
        case "/rosout" if ros.level > 20:
            print(f"{seconds:9.3f} s  ! {ros.name}: {ros.msg}")
        case "/cube":
            cube = ros.truth or ros.believed
        case "/track/servo":
            # One message for each servo period, with counters, currents, forces, commands, pulse
            # widths, and set and measured joints. Here only the force is used.
            force = sum(f * f for f in ros.wrench_in_tool[:3]) ** 0.5
            grip["force at the track's tool, N"] = max(
                force, grip.get("force at the track's tool, N", 0.0)
            )
for what, most in grip.items():
    print(f"largest {what}: {most:.2f}")
print("the cube at the end:", cube)
