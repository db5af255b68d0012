"""
A circle and Doppler
====================

A 40 kHz source goes round a circle once a second. The frequency at the receiver rises and falls.
The ground truth states it exactly.
"""

import numpy as np

import clsim

tone = clsim.Signal.tone(40e3, duration=1.0, sampling_rate=192e3, fade=0.01)
circle = clsim.Trajectory.circle(center=(4, 3, 1.5), radius=0.5, period=1.0, duration=1.0)
room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.0))  # no echoes
scene = clsim.Scene(
    room,
    clsim.Air(),
    [clsim.Source("robot", tone, circle)],
    [clsim.Receiver("ear", clsim.Trajectory.fixed((6.5, 3, 1.5)))],
)
paths = clsim.find_paths(scene, max_order=0)
recording = clsim.render(paths, sampling_rate=192e3, duration=1.0)

# %%
# Draw the spectrogram, and over it 40 kHz times the Doppler factor of the direct path.
times = np.linspace(0.05, 0.95, 91)
truth = clsim.direct_path(paths, times)
figure = recording.spectrogram("ear", band=(39e3, 41e3))
figure.axes[0].plot(times, 40e3 * truth.doppler_factor[0, 0] / 1e3, "w--", linewidth=1)

# %%
# Check: the frequency of the sound, from its phase, is that of the ground truth.
sound = recording.pressure[0].astype(np.float64)
spectrum = np.fft.fft(sound)
spectrum[len(sound) // 2 :] = 0.0  # the analytic signal
phase = np.unwrap(np.angle(np.fft.ifft(spectrum)))
heard = np.gradient(phase[::960], 960 / 192e3) / (2 * np.pi)
at = np.arange(len(heard)) * 960 / 192e3
told = 40e3 * np.interp(at, times, truth.doppler_factor[0, 0])
assert np.abs(heard - told)[20:180].max() < 1.0  # Hz, of a shift of 366 Hz
