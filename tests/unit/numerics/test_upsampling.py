"""Sound of complex envelopes: against its definition, and where there is none."""

from fractions import Fraction

import numpy as np
import pytest

from clsim.numerics.resampling import Upsampler

RATE = 192e3


def sound_of(made: Upsampler, envelope: np.ndarray, first: int) -> np.ndarray:
    """Return the sound of one envelope from its sample `first` on."""
    sound = np.zeros((1, (len(envelope) - 2 * made.reach + 1) * made.every), dtype=np.float32)
    made.add(envelope[None], first, sound, 0)
    return sound[0]


@pytest.mark.parametrize(("carrier", "every", "half"), [(40e3, 40, 1.9e3), (25_003.7, 24, 3.2e3), (8e3, 9, 7e3)])
def test_tones_come_out_at_the_carriers_side(carrier: float, every: int, half: float, measured) -> None:
    """Within -110 dB anywhere in the band; a sign of the phase or a sample's shift is wrong by 0 dB."""
    made = Upsampler.about(carrier, RATE, every, half)
    first = 123_456_789  # late, for the carrier's phase
    at = np.arange(first + 1 - made.reach, first + 300 + made.reach)
    for away in (-half, -0.3 * half, 0.0, half):
        phase = 2.0 * np.pi * (away * every / RATE * (at - first) + 0.3)
        got = sound_of(made, np.exp(1j * phase), first)
        n = np.arange(300 * every)
        turned = float(Fraction(carrier) * every * first / Fraction(RATE) % 1)
        wanted = np.cos(2.0 * np.pi * (turned + (carrier + away) / RATE * n + 0.3))
        found = 20.0 * np.log10(np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
        assert measured("sound of envelopes", "closed form", found, -110.0) < -110.0


def test_silence_stays_exact(rng: np.random.Generator) -> None:
    made = Upsampler.about(40e3, RATE, 40, 1.9e3)
    envelope = np.zeros(2000, dtype=np.complex64)
    envelope[1000:1010] = rng.normal(size=10) + 1j * rng.normal(size=10)
    got = sound_of(made, envelope, 0)
    sounding = np.flatnonzero(got) // 40 + made.reach - 1  # by samples of the envelope
    assert 1000 - made.reach <= sounding.min() < 1000
    assert 1009 < sounding.max() <= 1010 + made.reach


def test_pieces_are_parts_of_the_whole(rng: np.random.Generator) -> None:
    made = Upsampler.about(40e3, RATE, 40, 1.9e3)
    envelope = rng.normal(size=1500) + 1j * rng.normal(size=1500)
    whole = sound_of(made, envelope, 70)
    part = sound_of(made, envelope[300 : 700 + 2 * made.reach], 370)
    np.testing.assert_allclose(part, whole[300 * 40 :][: len(part)], atol=1e-5)
