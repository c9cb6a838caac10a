"""Checks a recording with the public reader.

Every message decodes, counts and types are right, and the last state of the cube is that of the
summary.
"""
import json
import sys
from collections import Counter

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

path = sys.argv[1]
counts, kinds, ticks, last = Counter(), {}, {}, {}
with open(path, "rb") as stream:
    reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
    assert reader.get_header().profile == "ros2"
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        counts[channel.topic] += 1
        kinds[channel.topic] = schema.name
        last[channel.topic] = decoded
        if channel.topic.endswith("/servo"):
            ticks.setdefault(channel.topic, []).append(decoded.period)
            assert len(decoded.counts) == 7 and len(decoded.currents) == 8
    facts = {m.name: m.metadata for m in reader.iter_metadata()}
    scenario = [a.data.decode() for a in reader.iter_attachments() if a.name == "scenario.toml"]

wanted = {
    "/robot_description": "std_msgs/msg/String",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/rosout": "rcl_interfaces/msg/Log",
    "/phase": "rubik_robot_msgs/msg/TaskPhase",
    "/cube": "rubik_robot_msgs/msg/CubeState",
    "/standalone/info": "sensor_msgs/msg/CameraInfo",
}
arms = facts["rubik_robot"]["arms"].split()
for arm in arms:
    wanted[f"/{arm}/servo"] = "rubik_robot_msgs/msg/ServoTick"
    wanted[f"/{arm}/wrench"] = "geometry_msgs/msg/WrenchStamped"
    wanted[f"/{arm}/tool"] = "geometry_msgs/msg/PoseStamped"
for topic, kind in wanted.items():
    assert kinds.get(topic) == kind, (topic, kinds.get(topic), kind)
periods = {topic: len(numbers) for topic, numbers in ticks.items()}
for topic, numbers in ticks.items():
    assert numbers == list(range(1, len(numbers) + 1)), f"{topic}: a period is missing"
assert len(set(periods.values())) == 1, periods
some = next(iter(periods.values()))
assert counts["/joint_states"] == len(arms) * (some // 8), (counts["/joint_states"], some)
summary = json.loads(facts["summary"]["json"])
cube = last["/cube"].truth
assert cube == summary["cube_end"], (cube, summary["cube_end"])
if facts["rubik_robot"]["task"] == "solve":
    letters = [cube[9 * face : 9 * face + 9] for face in range(6)]
    solved = all(len(set(face)) == 1 for face in letters)
    assert solved == (summary["outcome"] == "solved"), cube
    assert last["/cube"].believed, "the controller's belief is missing"
    assert counts["/plan"] >= 1 and counts["/track_hand/image"] >= 3
assert last["/phase"].outcome in ("solved", "done", "failed", "aborted")
assert scenario and "task" in scenario[0]
if "/standalone/image" in last:
    assert bytes(last["/standalone/image"].data[:2]) == b"\xff\xd8"
print(
    f"{path}: {sum(counts.values())} messages on {len(counts)} topics decode, "
    f"{some} servo periods without a gap;"
)
print(f"  ended: {last['/phase'].outcome}; the cube: {cube}")
