#!/usr/bin/env python3
"""Reads the topics of a run as a program of ROS 2 would, without ROS.

    tests/ros/try.py PROGRAM

PROGRAM is built with the feature net. The script is the router, starts a run with --ros, lists the
topics by their tokens, and decodes the messages of the standard types. Names and types come from
zenoh-ros2-sdk, hashes of types and the decoder from rosbags: both know nothing of this project.
"""

import collections
import subprocess
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_topic_names_and_types

PORT, DOMAIN = 17447, 3
STANDARD = ("std_msgs", "sensor_msgs", "geometry_msgs", "tf2_msgs", "rcl_interfaces")


def main(program):
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{PORT}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    router = zenoh.open(config)
    types = get_typestore(Stores.ROS2_JAZZY)
    command = [program, "run", "scenarios/face_turn.toml", "--speed", "1", "--json", "--ui", "none"]
    command += [f"--ros=tcp/127.0.0.1:{PORT}", "--ros-domain", str(DOMAIN)]
    run = subprocess.Popen(command, stdout=subprocess.PIPE)
    counts, missed, wrong, attached = collections.Counter(), 0, [], {}

    def take(sample):
        nonlocal missed
        domain, *topic, kind, told = str(sample.key_expr).split("/")
        topic, name = "/" + "/".join(topic), kind.replace("::dds_::", "/").replace("::", "/")[:-1]
        attachment = bytes(sample.attachment)
        number, length = int.from_bytes(attachment[:8], "little"), attachment[16]
        # A reader that is slow misses messages; none comes twice or in another order.
        if length != 16 or len(attachment) != 33 or number <= attached.get(topic, 0):
            wrong.append(f"{topic}: message {number} after {attached.get(topic, 0)}")
        missed += number - attached.get(topic, 0) - 1
        attached[topic] = number
        if name.split("/")[0] not in STANDARD:
            counts[topic] += 1
            return
        try:
            if told != types.hash_rihs01(name):
                wrong.append(f"{name}: hash {told}")
            types.deserialize_cdr(bytes(sample.payload), name)
            counts[topic] += 1
        except Exception as why:
            wrong.append(f"{topic}: {why!r}")

    descriptions = []
    subscriber = router.declare_subscriber(f"{DOMAIN}/**", take)
    late = None
    topics = []
    for _ in range(12):
        time.sleep(1)
        found = get_topic_names_and_types(DOMAIN, "127.0.0.1", PORT)
        topics = max(topics, found, key=len)
        # A reader that comes late still gets the description of the robot.
        if late is None and counts["/robot_description"]:
            late = ROS2Subscriber(
                "/robot_description", "std_msgs/msg/String", lambda m: descriptions.append(m.data),
                msg_definition="string data\n", domain_id=DOMAIN, router_port=PORT)
    code = run.wait()
    subscriber.undeclare()
    for name, kinds in topics:
        print(f"{name} [{', '.join(kinds)}]: {counts[name]} messages")
    assert code == 0, f"the run ended with code {code}"
    assert not wrong, wrong[:10]
    assert missed < 0.02 * sum(counts.values()), f"{missed} messages missed"
    assert {name for name, _ in topics} >= {"/joint_states", "/tf", "/robot_description"}, topics
    assert all(counts[name] for name, _ in topics), "a topic without a message"
    assert descriptions and descriptions[0].startswith("<?xml"), "no description for a late reader"
    left = get_topic_names_and_types(DOMAIN, "127.0.0.1", PORT)
    ours = [name for name, _ in left if name != "/robot_description"]
    assert not ours, f"topics after the run: {ours}"
    print(f"{len(topics)} topics, {sum(counts.values())} messages ({missed} missed), all decoded")
    late.close()


main(*sys.argv[1:])
