"""
Your own simulator's delays
===========================

clsim also renders delays and gains from any other program. Here two paths follow formulae: a
source that passes by, and its echo from the ground.
"""

import numpy as np
from matplotlib import pyplot

import clsim

speed, height, nearest = 30.0, 1.5, 2.0  # m/s, m, m
times = np.linspace(0.0, 0.5, 501)
x = speed * (times - 0.25)
ways = np.stack([np.hypot(x, nearest), np.sqrt(x**2 + nearest**2 + (2 * height) ** 2)])
delays, gains = ways / 343.0, np.array([[1.0], [0.5]]) / ways

tone = clsim.Signal.tone(20e3, duration=0.5, sampling_rate=96e3, fade=0.005)
tracks = clsim.Tracks.from_samples(times, delays, gains)
recording = clsim.render_tracks([tone], tracks, sampling_rate=96e3)

# %%
# Draw the two paths. Each line crosses 20 kHz where its path is shortest.
figure, axes = pyplot.subplots(layout="constrained")
axes.specgram(recording.pressure[0] + 1e-9, NFFT=1024, noverlap=896, Fs=96e3, vmin=-140)
axes.set(xlabel="time (s)", ylabel="frequency (Hz)", ylim=(17e3, 23e3))
for delay in delays:
    axes.plot(times, 20e3 * (1 - np.gradient(delay, times)), "w--", linewidth=0.8)

# %%
# Check: a sample in the middle is the sum of both paths, each at its own delay.
sample = 20_000
t = sample / 96e3
expected = sum(
    np.interp(t, times, gain) * np.sin(2 * np.pi * 20e3 * (t - np.hypot(speed * (t - 0.25), across) / 343.0))
    for gain, across in zip(gains, (nearest, np.hypot(nearest, 2 * height)), strict=True)
)
assert abs(recording.pressure[0, sample] - expected) < 0.01
