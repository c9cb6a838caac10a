#!/usr/bin/env python3
"""Reads a recording and a campaign into pandas tables, prints them, and draws them.

    pip install mcap mcap-ros2-support pandas matplotlib
    rubik-robot run scenarios/solve.toml --record run.mcap
    rubik-robot campaign scenarios/solve.toml --runs 20 --state runs.jsonl --json \\
        | tail -1 > campaign.json
    python3 examples/plot_run.py run.mcap campaign.json runs.jsonl -o run.png
    python3 examples/plot_run.py run.mcap --table

Each file may be left out. A recording (.mcap) gives the phases, the turns, and the forces of both
hands, which are drawn with the turns as bands. The object of `campaign --json` (.json) gives the
distribution of each quantity; the state file of `campaign --state` (.jsonl) gives the single runs,
whose times are drawn as a histogram. --table prints the tables and draws nothing.
"""
import argparse
import json
import sys
from pathlib import Path

import pandas as pd
from mcap.exceptions import McapError
from mcap_ros2.reader import read_ros2_messages

FACES = "URFDLB"
# Colours that people with a colour vision deficiency can tell apart.
HANDS = ["tab:blue", "tab:orange"]


def read_recording(path):
    """Returns the tables `forces` (N, by time), `turns` and `phases` of a recording."""
    forces, turns, phases, start = {}, [], [], None
    for message in read_ros2_messages(str(path)):
        topic, ros = message.channel.topic, message.ros_msg
        # A run in real time is stamped with Unix time, so times count from the first message.
        start = message.log_time_ns if start is None else start
        time = (message.log_time_ns - start) * 1e-9
        if topic.endswith("/wrench"):
            force = ros.wrench.force
            norm = (force.x**2 + force.y**2 + force.z**2) ** 0.5
            forces.setdefault(topic.split("/")[1], {})[time] = norm
        elif topic == "/phase":
            phases.append({"begin": time, "phase": ros.name, "outcome": ros.outcome})
        elif topic == "/belief":
            turning = json.loads(ros.data)["turning"]
            if turns and turns[-1]["end"] is None and turns[-1]["key"] != turning:
                turns[-1]["end"] = time
            if turning and (not turns or turns[-1]["end"] is not None):
                turn = {"begin": time, "end": None, "hand": turning[0], "face": FACES[turning[1]]}
                turns.append({**turn, "key": turning})
    forces = pd.DataFrame(forces).sort_index()
    forces.index.name = "time"
    turns = pd.DataFrame(turns, columns=["begin", "end", "hand", "face"])
    # A run that an error ended may end in a turn.
    turns["end"] = turns["end"].astype(float).fillna(forces.index.max())
    turns["seconds"] = turns["end"] - turns["begin"]
    hands = list(forces.columns)
    turns["hand"] = [hands[hand] for hand in turns["hand"]]
    turns["largest_n"] = [
        forces.loc[turn.begin : turn.end].max().max() for turn in turns.itertuples()
    ]
    phases = pd.DataFrame(phases, columns=["begin", "phase", "outcome"])
    phases["seconds"] = phases["begin"].shift(-1) - phases["begin"]
    return forces, turns, phases


def read_campaign(path):
    """Returns the share of solved runs in words, and the distributions as a table."""
    result = json.loads(Path(path).read_text())
    low, high = result["interval"]
    words = (
        f"{result['solved']} of {result['runs']} runs of {result['scenario']} solved; "
        f"95 % interval {100 * low:.1f} .. {100 * high:.1f} %"
    )
    spreads = {name: value for name, value in result.items() if is_spread(value)}
    return words, pd.DataFrame(spreads).T


def is_spread(value):
    """Returns whether a value of the object is a distribution with data."""
    return isinstance(value, dict) and value.get("median") is not None


def read_runs(path):
    """Returns the single runs of a campaign's state file as a table."""
    # The first line, and that of a campaign that was extended, is a header without a verdict.
    lines = [json.loads(line) for line in Path(path).read_text().splitlines()]
    runs = [line for line in lines if "verdict" in line]
    figures = pd.DataFrame([run["figures"] or {} for run in runs])
    table = pd.DataFrame(runs)[["seed", "verdict", "phase"]]
    wanted = ["sim_time_s", "turns", "grasps", "peak_force_n", "recoveries"]
    return table.join(figures.reindex(columns=wanted)).set_index("seed").sort_index()


def draw_forces(axes, forces, turns):
    """Draws the forces of the hands, with the turns as bands."""
    for hand, colour in zip(forces.columns, HANDS):
        curve = forces[hand].dropna()
        axes.plot(curve.index, curve, color=colour, linewidth=0.7, label=f"{hand} hand")
    top = 1.08 * forces.max().max()
    for number, turn in enumerate(turns.itertuples()):
        label = "turn of a face" if number == 0 else None
        # The white edges part two turns without a pause between them.
        band = {"facecolor": "0.85", "edgecolor": "white", "zorder": 0, "label": label}
        axes.axvspan(turn.begin, turn.end, **band)
        middle = 0.5 * (turn.begin + turn.end)
        axes.text(middle, 0.98 * top, turn.face, ha="center", va="top", fontsize=8)
    axes.set(xlabel="time (s)", ylabel="force at the tool (N)", ylim=(0, top))
    axes.margins(x=0.01)
    # Above the curves, which fill the whole width.
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)


def draw_times(axes, runs):
    """Draws the histogram of the mission times, solved runs apart from the others."""
    solved = runs["verdict"] == "solved"
    parts = [("solved", "tab:green", runs[solved]), ("not solved", "tab:red", runs[~solved])]
    parts = [part for part in parts if len(part[2]) > 0]
    axes.hist(
        [part["sim_time_s"].dropna() for _, _, part in parts],
        bins=min(40, 3 + len(runs) // 3),
        stacked=True,
        edgecolor="white",
        color=[colour for _, colour, _ in parts],
        label=[f"{word}: {len(part)}" for word, _, part in parts],
    )
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.axvline(runs["sim_time_s"].median(), color="black", linestyle="--", label="median")
    axes.set(xlabel="mission time (s)", ylabel="runs")
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)


def main():
    """Reads the files of the command line, prints their tables, and draws them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    files = "run.mcap, campaign.json, runs.jsonl"
    parser.add_argument("files", nargs="+", metavar="FILE", help=files)
    parser.add_argument("--table", action="store_true", help="print the tables and draw nothing")
    parser.add_argument("-o", "--out", default="run.png", help="picture to write (run.png)")
    arguments = parser.parse_args()

    try:
        pictures = tables(parser, arguments.files)
    except McapError as why:
        # A crash or a full disk cuts a recording off; the packages read whole ones only.
        sys.exit(f"{why}; `rubik-robot recover` makes a whole recording of one that was cut off")
    if arguments.table or not pictures:
        return
    draw(pictures, arguments.out)


def tables(parser, files):
    """Prints the tables of the files. Returns what to draw: functions with their tables."""
    pictures = []
    for path in files:
        match Path(path).suffix:
            case ".mcap":
                forces, turns, phases = read_recording(path)
                print(f"{path}: phases (s)\n{phases.to_string(index=False)}\n")
                print(f"{path}: turns (s, N)\n{turns.round(3).to_string(index=False)}\n")
                print(f"{path}: forces of the hands (N)\n{forces.describe().round(2)}\n")
                pictures.append((draw_forces, (forces, turns)))
            case ".json":
                words, spreads = read_campaign(path)
                print(f"{path}: {words}\n{spreads.round(2)}\n")
            case ".jsonl":
                runs = read_runs(path)
                print(f"{path}: single runs\n{runs.round(2).to_string()}\n")
                pictures.append((draw_times, (runs,)))
            case _:
                parser.error(f"{path}: expected a file that ends in .mcap, .json or .jsonl")
    return pictures


def draw(pictures, out):
    """Draws the pictures below each other into a file."""
    from matplotlib import pyplot

    size = (11, 4 * len(pictures))
    figure, axes = pyplot.subplots(len(pictures), figsize=size, squeeze=False, layout="tight")
    for (draw_into, data), place in zip(pictures, axes[:, 0]):
        draw_into(place, *data)
    figure.savefig(out, dpi=150)
    print(f"{out}: drawn")


if __name__ == "__main__":
    main()
