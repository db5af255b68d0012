"""
A thousand receivers
====================

An array is a grid of positions. All receivers share the images of the source. Here a ceiling of
1000 receivers records one chirp and shows the field as a picture.
"""

import numpy as np
from matplotlib import pyplot

import clsim

chirp = clsim.Signal.chirp(38e3, 42e3, duration=0.002, sampling_rate=192e3, window="hann")
source = clsim.Source(
    "source", chirp, clsim.Trajectory.fixed((2.5, 2.0, 1.0)), directivity=clsim.Piston(5e-3), aim=(0.3, 0.0, 1.0)
)
grid = clsim.grid_positions((0.2, 7.8, 40), (0.2, 5.8, 25), 2.9)
ears = clsim.receiver_array("ceiling", grid)
room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.0))
scene = clsim.Scene(room, clsim.Air(), [source], ears)
recording = clsim.render(clsim.find_paths(scene, max_order=0), sampling_rate=192e3)

# %%
# Draw the peak pressure of each receiver.
peak = np.abs(recording.pressure).max(axis=1)
figure, axes = pyplot.subplots(layout="constrained")
image = axes.scatter(*grid.T[:2], c=20 * np.log10(peak / peak.max()), s=22, marker="s", vmin=-40)
axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
figure.colorbar(image, label="level (dB of the highest)")

# %%
# Check: there are a thousand rows. The highest is near where the beam points, not above the
# source.
assert recording.pressure.shape[0] == 1000
assert np.linalg.norm(grid[peak.argmax(), :2] - (2.5 + 0.3 * 1.9, 2.0)) < 0.4
