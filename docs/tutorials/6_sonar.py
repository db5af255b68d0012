"""
Sonar
=====

Moving things scatter sound. Their echoes are far below the direct sound; ``direct=False`` leaves
the direct sound out.
"""

import numpy as np
from matplotlib import pyplot

import clsim

pulse = clsim.Signal.chirp(36e3, 44e3, duration=0.004, sampling_rate=192e3, window="hann")
sonar = clsim.Source("sonar", clsim.Signal.pulses(pulse, period=0.05, count=16), clsim.Trajectory.fixed((1, 2.45, 1.2)))
ear = clsim.Receiver("ear", clsim.Trajectory.fixed((1, 2.55, 1.2)))
way = clsim.Trajectory.line((4.5, 2.5, 1.2), (2.5, 2.5, 1.2), duration=0.9)
ball = clsim.Scatterer.sphere("ball", 0.1, way)
room = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.0))
scene = clsim.Scene(room, clsim.Air(), [sonar], [ear], scatterers=[ball])
echoes = clsim.find_paths(scene, max_order=0, scattering_order=0, direct=False)
recording = clsim.render(echoes, sampling_rate=192e3)

# %%
# Draw the echoes, one row for each pulse, over the time since it was sent. The ball comes nearer.
period = round(0.05 * 192e3)
sound = np.resize(np.pad(recording.pressure[0], (0, period)), 16 * period)
rows = sound.reshape(16, period)
correlation = np.abs(np.array([np.correlate(row, pulse.read(0, pulse.count), "valid") for row in rows]))
figure, axes = pyplot.subplots(layout="constrained")
span = (0.0, 1e3 * correlation.shape[1] / 192e3, 0.0, 16.0)
axes.imshow(correlation, aspect="auto", origin="lower", extent=span)
axes.set(xlabel="time since the pulse (ms)", ylabel="pulse")

# %%
# Check: each peak is at the travel time there and back, less the shift of a chirp's peak by
# Doppler. That is ``f T / B`` times the relative Doppler shift.
sent = 0.05 * np.arange(16)
peaks = correlation.argmax(axis=1) / 192e3
ball_at = way.position(sent + 0.5 * peaks)
speed_of_sound = scene.air.speed_of_sound
ways = 2 * (np.hypot(ball_at[:, 0] - 1.0, 0.05) - 0.1)  # to the nearest point of the ball
doppler = 2 * (2.0 / 0.9) / speed_of_sound
expected = ways / speed_of_sound - 40e3 * 0.004 / 8e3 * doppler
assert np.abs(peaks - expected).max() < 60e-6  # s
truth = clsim.scatterer_truth(scene, sent + 0.5 * peaks)
np.testing.assert_allclose(truth.range[0, 0, 0], ways / 2, atol=0.03)
