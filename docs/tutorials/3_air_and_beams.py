"""
Air and beams
=============

At 40 kHz air absorbs more than 1 dB per metre, and transducers have narrow beams. Both depend on
the frequency and act over the whole band of the signal.
"""

import numpy as np
from matplotlib import pyplot

import clsim

air = clsim.Air(temperature_celsius=20.0, relative_humidity=0.5)
frequencies = np.linspace(20e3, 60e3, 81)
angles = np.radians(np.linspace(-90, 90, 181))
piston = clsim.Piston(radius=4.5e-3)

figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
left.plot(frequencies / 1e3, air.absorption_at(frequencies))
left.set(xlabel="frequency (kHz)", ylabel="absorption (dB/m)")
for frequency in (25e3, 40e3, 55e3):
    gain = np.abs(piston.gain(np.cos(angles), frequency, air.speed_of_sound))
    right.plot(np.degrees(angles), 20 * np.log10(np.maximum(gain, 1e-3)), label=f"{frequency / 1e3:g} kHz")
right.set(xlabel="angle (°)", ylabel="gain (dB)")
right.legend()

# %%
# In a scene, air and directivity are properties. A receiver that is turned by 60 degrees receives
# less, by the gain of its beam.
room = clsim.Shoebox((9.0, 5.0, 3.0), clsim.Material.from_reflection(0.0))
tone = clsim.Signal.tone(40e3, duration=0.05, sampling_rate=192e3, fade=0.005)
source = clsim.Source("source", tone, clsim.Trajectory.fixed((1, 2.5, 1.5)))
aims = {"ahead": (-1.0, 0.0, 0.0), "aside": (-np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0)}
ears = [
    clsim.Receiver(name, clsim.Trajectory.fixed((6, 2.5, 1.5)), directivity=piston, aim=aim)
    for name, aim in aims.items()
]
recording = clsim.render(clsim.find_paths(clsim.Scene(room, air, [source], ears), max_order=0), sampling_rate=192e3)
ahead, aside = np.sqrt(np.mean(recording.pressure[:, 5000:8000] ** 2, axis=1))

# %%
# Check: the level at 5 m of a source whose amplitude is that at 1 m, and the gain of the beam.
loss = 10 ** (-4.0 * air.absorption_at(40e3) / 20)
np.testing.assert_allclose(ahead, loss / 5.0 / np.sqrt(2), rtol=1e-3)
np.testing.assert_allclose(aside / ahead, np.abs(piston.gain(0.5, 40e3, air.speed_of_sound)), rtol=1e-3)
