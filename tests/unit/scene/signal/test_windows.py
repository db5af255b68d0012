"""Short-time spectra of windows that are read together are those of windows read one by one."""

import numpy as np
import pytest

import clsim


def one_by_one(signal: clsim.Signal) -> tuple[np.ndarray, np.ndarray]:
    """Return energies and weights by the definition: each window with its neighbours on either side."""
    length = 2 ** int(np.clip(round(np.log2(0.04 * signal.sampling_rate)), 6, 14))
    hop, window = length // 2, np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    found, levels = [], []
    for k in range(-1, -(-signal.count // hop)):
        around = signal.read((k - 1) * hop, (k + 1) * hop + length)
        level = max(float(np.sum((around[i : i + length] * window) ** 2)) for i in (0, hop, 2 * hop)) * length
        if np.any(around[hop:-hop]) and level > 0.0:
            spectrum = np.abs(np.fft.rfft(around[hop:-hop] * window)) ** 2
            spectrum[1:-1] *= 2.0
            found.append(spectrum)
            levels.append(level)
    return np.array(found) / np.maximum(levels, 1e-6 * max(levels))[:, None], np.array(levels)


@pytest.mark.parametrize("count", [100, 5000, 60_000])
def test_windows_together_are_windows_one_by_one(count: int, rng: np.random.Generator) -> None:
    samples = rng.standard_normal(count)
    samples[count // 3 : count // 2] = 0.0  # a pause
    signal = clsim.Signal.from_array(samples, sampling_rate=16e3)
    energy, levels = one_by_one(signal)
    _, found, weights, _ = signal.short_time_spectra()
    np.testing.assert_allclose(found, energy, rtol=1e-12, atol=1e-18)
    assert np.array_equal(weights, np.ones(len(levels)))
