"""
A mesh room and a corner
========================

Rooms may have any shape. Here it is a floor plan; ``MeshRoom.from_file`` reads a mesh. A path is
active exactly while walls let it pass. With ``diffraction=1`` sound goes round edges and fills
the shadow.
"""

import numpy as np
from matplotlib import pyplot

import clsim

wall = clsim.Material.from_reflection(0.6)
room = clsim.MeshRoom.from_plan([(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)], 3.0, wall)
walk = clsim.Trajectory.line((2.0, 8.0, 1.4), (3.0, 2.0, 1.4), duration=3.0)
tone = clsim.Signal.tone(40e3, duration=3.0, sampling_rate=192e3)
scene = clsim.Scene(
    room,
    clsim.Air(),
    [clsim.Source("robot", tone, walk)],
    [clsim.Receiver("ear", clsim.Trajectory.fixed((7.0, 1.0, 1.4)))],
)
paths = clsim.find_paths(scene, max_order=1, diffraction=1)
times = np.linspace(0.0, 2.95, 300)
table = paths.table(times)

# %%
# Draw delays over time. Paths round the corner are dashed. The direct sound begins when the robot
# comes into sight.
turned = np.any(table.interactions == 1, axis=1)
figure, axes = pyplot.subplots(layout="constrained")
for path in range(len(table.order)):
    delay = np.where(table.audible[path], table.delay[path], np.nan)
    axes.plot(times, 1e3 * delay, "--" if turned[path] else "-", color=f"C{table.order[path]}", linewidth=1)
axes.set(xlabel="time (s)", ylabel="delay (ms)")

# %%
# Check: the direct sound begins one travel time after source, corner and receiver are in line.
first = times[table.audible[(table.order == 0) & ~turned].any(axis=0)][0]
positions = walk.position(times)
side = (positions[:, 0] - 7.0) * (4.0 - 1.0) - (positions[:, 1] - 1.0) * (4.0 - 7.0)
in_line = times[np.flatnonzero(np.diff(np.sign(side)))[0] + 1]
assert abs(first - in_line) < 0.03
