"""
What walls add
==============

Each wall is a mirror. Behind it is an image of the source, and the number of mirrors is the order
of the path. The material says how much of the sound a wall reflects.
"""

import numpy as np
from matplotlib import pyplot

import clsim

click = clsim.Signal.chirp(20e3, 60e3, duration=0.001, sampling_rate=192e3, window="hann")
source = clsim.Source("source", click, clsim.Trajectory.fixed((2.0, 2.0, 1.2)))
receiver = clsim.Receiver("receiver", clsim.Trajectory.fixed((5.0, 3.5, 1.6)))

figure, rows = pyplot.subplots(2, sharex=True, sharey=True, layout="constrained")
for axes, material in zip(rows, ["estimated-painted-concrete", "estimated-carpet"], strict=True):
    room = clsim.Shoebox((7.0, 5.0, 2.7), clsim.Material.named(material))
    scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
    table = clsim.find_paths(scene, max_order=3).table([0.0])
    level = 20 * np.log10(np.abs(table.gain[:, 0]))
    points = axes.scatter(1e3 * table.delay[:, 0], level, c=table.order, s=12)
    axes.set(ylabel="gain (dB)", title=material, ylim=(-110, 0))
rows[-1].set_xlabel("delay (ms)")
figure.colorbar(points, ax=rows, label="order", ticks=range(4))

# %%
# Check: up to order 3 there are as many paths as the closed form says. None arrives before the
# direct sound.
assert len(table.order) == 1 + 2 * 3 * (2 * 3**2 + 3 * 3 + 4) // 3
assert np.argmin(table.delay[:, 0]) == np.flatnonzero(table.order == 0)[0]
