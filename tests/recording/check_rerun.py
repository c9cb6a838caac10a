"""Imports a recording into rerun.

Checks that the joint curves, the frames, the log and the robot appear, and runs rerun's own check.
"""
import os
import subprocess
import sys
import tempfile
from pathlib import Path

path = sys.argv[1]
rerun = str(Path(sys.executable).parent / "rerun")
if subprocess.run([rerun, "mcap", "--help"], capture_output=True).returncode != 0:
    reason = "this rerun cannot read MCAP on the command line; the recording was NOT opened by it"
    print("SKIPPED:", reason)
    with open(os.environ.get("SKIPPED", os.devnull), "a") as left_out:
        print(reason, file=left_out)
    sys.exit(0)
with tempfile.TemporaryDirectory() as folder:
    rrd = str(Path(folder) / "run.rrd")
    made = subprocess.run(
        [rerun, "mcap", "convert", path, "-o", rrd], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stdout + made.stderr
    printed = subprocess.run([rerun, "rrd", "print", rrd], capture_output=True, text=True).stdout
checked = subprocess.run([rerun, "mcap", "check", path], capture_output=True, text=True)
assert checked.returncode == 0, checked.stdout + checked.stderr
for entity in ["/joint_states", "/tf", "/rosout", "/robot_description"]:
    assert entity in printed, f"rerun does not show {entity}"
print(f"{path}: rerun takes it; {printed.count('Chunk')} chunks; its own check finds nothing wrong")
