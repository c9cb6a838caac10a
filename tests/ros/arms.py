#!/usr/bin/env python3
"""Gives a run joint commands and a camera pictures, as programs of ROS 2 would, without ROS.

    tests/ros/arms.py PROGRAM

PROGRAM is built with the feature net. The script is the router. Names come from zenoh-ros2-sdk,
hashes of types and the encoder from rosbags: both know nothing of this project.
"""

import atexit
import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time

import numpy
import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk.keyexpr import topic_keyexpr
from zenoh_ros2_sdk.utils import ros2_to_dds_type

PORT, DOMAIN = 17448, 5
TYPES = get_typestore(Stores.ROS2_JAZZY)
JOINTS, IMAGE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Image"
ENDPOINT = f"tcp/127.0.0.1:{PORT}"
NOISE = numpy.random.default_rng(1)


def message(kind, /, **fields):
    return TYPES.types[kind](**fields)


def header(stamp):
    time_ = message("builtin_interfaces/msg/Time", sec=int(stamp), nanosec=int(stamp % 1 * 1e9))
    return message("std_msgs/msg/Header", stamp=time_, frame_id="")


class Publisher:
    """Publisher of a topic, as rmw_zenoh has it."""

    def __init__(self, session, topic, kind, gid):
        key = topic_keyexpr(DOMAIN, topic, ros2_to_dds_type(kind), TYPES.hash_rihs01(kind))
        self.topic, self.kind, self.count = session.declare_publisher(key), kind, 0
        self.gid = bytes([gid]) * 16

    def put(self, what):
        self.count += 1
        attachment = struct.pack("<QQB", self.count, time.time_ns(), 16) + self.gid
        self.topic.put(bytes(TYPES.serialize_cdr(what, self.kind)), attachment=attachment)

    def joints(self, positions):
        empty = numpy.zeros(0)
        self.put(message(
            JOINTS, header=header(time.time()), name=list(positions),
            position=numpy.array(list(positions.values())), velocity=empty, effort=empty))


class Run:
    """Run of scenarios/ros_arms.toml whose joint states are read."""

    def __init__(self, program, router, *more):
        self.states, self.before, self.errors = {}, None, []
        key = topic_keyexpr(DOMAIN, "/joint_states", ros2_to_dds_type(JOINTS), "*")
        self.subscriber = router.declare_subscriber(key, self.take)
        self.at, self.fastest, self.farthest = None, {}, {}
        command = [program, "run", "scenarios/ros_arms.toml", "--speed", "1", "--json", "--ui",
                   "none", f"--ros={ENDPOINT}", "--ros-domain", str(DOMAIN), *more]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        # A check that fails must not leave the run behind.
        atexit.register(self.process.kill)
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def read(self):
        for line in self.process.stderr:
            self.errors.append(line.rstrip())

    def take(self, sample):
        state = TYPES.deserialize_cdr(bytes(sample.payload), JOINTS)
        stamp = state.header.stamp.sec + state.header.stamp.nanosec * 1e-9
        now = dict(zip(state.name, map(float, state.position)))
        # Speeds over 0.1 s: single messages have the noise of the counters.
        if self.at is None or stamp - self.at[0] > 0.1:
            for name, position in now.items():
                if self.at and name in self.at[1]:
                    speed = abs(position - self.at[1][name]) / (stamp - self.at[0])
                    self.fastest[name] = max(self.fastest.get(name, 0), speed)
            self.at = (stamp, now)
        self.states = now

    def joints(self, arm):
        """Waits for the states of all joints of an arm."""
        wanted = re.compile(rf"{arm}_link\d_joint")
        for _ in range(600):
            found = {n: p for n, p in self.states.items() if wanted.fullmatch(n)}
            if len(found) == (7 if arm == "track" else 6):
                return found
            time.sleep(0.1)
        raise AssertionError(f"no joint states: {self.errors}")

    def said(self, words):
        """Waits for words of the program."""
        for _ in range(60):
            if any(words in line for line in self.errors):
                return
            time.sleep(0.1)
        raise AssertionError(f"not said: {words}; but {self.errors}")

    def end(self):
        self.process.send_signal(signal.SIGINT)
        out = self.process.stdout.read()
        code = self.process.wait(60)
        self.reader.join()
        self.subscriber.undeclare()
        return code, json.loads(out.strip().splitlines()[-1])


def stream(publisher, target, seconds, begin=None):
    """Publishes a way of 100 Hz from `begin` to `target` as a trajectory controller would."""
    steps = int(100 * seconds)
    begin = begin or target
    for i in range(steps):
        share = 0.5 - 0.5 * math.cos(math.pi * min(1.0, (i + 1) / (0.7 * steps)))
        publisher.joints({n: begin[n] + share * (target[n] - begin[n]) for n in target})
        time.sleep(0.01)


def distance(one, other):
    return max(abs(one[name] - other[name]) for name in other)


def moves(start, by):
    return {name: at + by.get(name, 0.0) for name, at in start.items()}


def follow(program, router, folder):
    """Commands move an arm; wrong ones, silence and a way out of its reach do not."""
    record = os.path.join(folder, "arms.mcap")
    run = Run(program, router, "--record", record)
    publisher = Publisher(router, "/joint_commands", JOINTS, 1)
    start = run.joints("postument")
    other = run.joints("track")
    target = moves(start, {"postument_link1_joint": 0.3, "postument_link6_joint": -0.4})
    stream(publisher, target, 6, start)
    reached = run.joints("postument")
    # The truth has backlash and sag: joint_states are those of the encoders.
    assert distance(reached, target) < 0.005, (reached, target)
    assert distance(run.joints("track"), other) < 0.002, "the other arm has moved"
    print(f"followed to {1e3 * distance(reached, target):.2f} mrad, "
          f"fastest {max(run.fastest.values()):.2f} rad/s")

    # Silence in the middle of a way: the arm holds.
    begun = time.monotonic()
    half = moves(target, {"postument_link1_joint": -0.15})
    stream(publisher, half, 1.0, target)
    time.sleep(1.5)
    held = run.joints("postument")
    time.sleep(1.0)
    assert distance(run.joints("postument"), held) < 0.002, "the arm moves in silence"
    print(f"silence: holds after {time.monotonic() - begun:.1f} s")

    # Refused commands, each with its reason; the arm stays.
    for wrong, words in [
        (moves(held, {"postument_link1_joint": 1.0}), "a jump of 57.3 deg"),
        (moves(held, {"postument_link2_joint": 3.0}), "is outside its limits"),
        ({**held, "moon_joint": 0.0}, 'there is no joint "moon_joint"'),
        (dict(list(held.items())[:3]), "the command has no postument_link4_joint"),
        (moves(held, {"postument_link1_joint": math.nan}), "NaN deg is outside"),
    ]:
        stream(publisher, wrong, 0.5)
        run.said(words)
        assert distance(run.joints("postument"), held) < 0.002, words
        # The next fault is reported again once a right command has come.
        stream(publisher, held, 0.5)

    # Another program commands as well: both are refused.
    rival = Publisher(router, "/joint_commands", JOINTS, 2)
    there = moves(held, {"postument_link1_joint": 0.1})
    for _ in range(50):
        publisher.joints(there)
        rival.joints(held)
        time.sleep(0.01)
    run.said("two programs publish this topic")
    assert distance(run.joints("postument"), held) < 0.003, "two programs move an arm"
    time.sleep(0.6)

    # A way out of the arm's reach, in small steps: the arm stops before its end.
    low, at = dict(held), 0
    while not any("does not follow its targets" in line for line in run.errors):
        at += 1
        assert at < 3000, f"nothing stops the arm: {run.joints('postument')}"
        low["postument_link2_joint"] += 0.001
        low["postument_link3_joint"] += 0.0005
        publisher.joints(low)
        time.sleep(0.01)
    print([line for line in run.errors if "does not follow" in line][0])
    code, summary = run.end()
    assert code == 130, (code, summary["reason"])
    assert summary["collisions"] == 0 and not summary["accidents"], summary["accidents"]
    verify = subprocess.run(
        [program, "replay", record, "--verify"], capture_output=True, text=True, timeout=600)
    assert verify.returncode == 0, verify.stdout + verify.stderr
    print(verify.stdout.strip().splitlines()[-1])


def stopped(program, router):
    """A stop stays a stop while commands come on."""
    stop = ["--set", 'fault=[{kind="emergency_stop",at_s=4}]']
    run = Run(program, router, *stop)
    publisher = Publisher(router, "/joint_commands", JOINTS, 3)
    start = run.joints("postument")
    begun = time.monotonic()
    while run.process.poll() is None and time.monotonic() - begun < 30:
        by = 0.1 * math.sin(0.5 * (time.monotonic() - begun))
        publisher.joints(moves(start, {"postument_link1_joint": by}))
        time.sleep(0.01)
    code, summary = run.end()
    assert code == 3, (code, summary["reason"])
    assert summary["violations"]["moved_after_stop"] == 0, summary["violations"]
    print(f"emergency stop: exit code {code}, {summary['reason']}")


def face(own, edges, moved):
    """Draws a face of a cube on 640x480 px: its stickers on black plastic before a grey wall."""
    pixels = numpy.full((480, 640, 3), 120, dtype=numpy.uint8)
    left, top = 190 + moved, 110
    pixels[top:top + 260, left:left + 260] = 15
    for row in range(3):
        for column in range(3):
            colour = edges if (row + column) % 2 else own
            y, x = top + 8 + 82 * row, left + 8 + 82 * column
            pixels[y:y + 74, x:x + 74] = colour
    # A picture without the noise of a camera is refused.
    noise = NOISE.normal(0, 3, pixels.shape)
    return numpy.clip(pixels + noise, 0, 255).astype(numpy.uint8)


def scan(program, router):
    """A camera reads a cube in pictures of a topic, some of them in the other order of colours."""
    white, red, green = (235, 235, 230), (185, 20, 25), (10, 140, 50)
    yellow, orange, blue = (240, 215, 20), (250, 110, 10), (10, 60, 170)
    pairs = [(white, yellow), (red, orange), (green, blue)]
    faces = [(a, b) for a, b in pairs] + [(b, a) for a, b in pairs]
    publisher = Publisher(router, "/cube/image_raw", IMAGE, 4)
    command = [program, "vision", "scan", "--camera", "ros:/cube/image_raw", "--router", ENDPOINT,
               "--ui", "none"]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
    run = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    begun = time.monotonic()
    while run.poll() is None and time.monotonic() - begun < 90:
        for number, (own, edges) in enumerate(faces):
            for i in range(20):
                pixels = face(own, edges, number + i // 10)
                bgr = number % 2 == 1
                publisher.put(message(
                    IMAGE, header=header(time.time()), height=480, width=640,
                    encoding="bgr8" if bgr else "rgb8", is_bigendian=0, step=1920,
                    data=(pixels[:, :, ::-1] if bgr else pixels).reshape(-1)))
                time.sleep(0.06)
    run.terminate()
    out, err = run.communicate()
    assert run.returncode == 0, (run.returncode, out, err)
    checks = {"U": "D", "R": "L", "F": "B", "D": "U", "L": "R", "B": "F"}
    wanted = "".join((own + checks[own]) * 4 + own for own in "URFDLB")
    assert wanted in out, out
    print(f"cube read in pictures of a topic: {wanted}")


def silent(program):
    """A camera without pictures is a silent camera."""
    command = [program, "run", "scenarios/acquire.toml", "--json", "--ui", "none", "--speed", "20",
               "--set", "camera.standalone.source=ros", "--set", f"ros.router={ENDPOINT}",
               "--set", "camera.standalone.calibrate_views=0"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    words = "topic /standalone/image_raw: no picture for 1 s"
    assert run.returncode == 1 and words in run.stderr, (run.returncode, run.stderr[-2000:])
    print(f"no pictures: {json.loads(run.stdout.strip().splitlines()[-1])['reason']}")


def main(program):
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["{ENDPOINT}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    router = zenoh.open(config)
    with tempfile.TemporaryDirectory() as folder:
        follow(program, router, folder)
        stopped(program, router)
        scan(program, router)
        silent(program)


main(*sys.argv[1:])
