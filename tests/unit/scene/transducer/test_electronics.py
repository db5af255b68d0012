"""The receiver's end, stage by stage: noise, cuts, converter, and bad input."""

import numpy as np
import pytest
from scipy.signal import butter

import clsim
from clsim import Electronics, InputError, Transducer
from clsim.numerics.convolution import StreamFilter
from clsim.render.plan import SEGMENT
from clsim.render.render import ReceiverEnd

RATE = 192e3
COUNT = 3 * SEGMENT + 1234
PLACE = clsim.Trajectory.fixed((1, 1, 1))
RESONANCE = Transducer.resonance(40e3, 2.4e3, 0.007)


def recorded(samples: np.ndarray, name: str = "r", transducer: Transducer | None = None, **electronics) -> np.ndarray:
    """Return the recording of pressure (n,) by a receiver, in one block."""
    receiver = clsim.Receiver(name, PLACE, transducer=transducer, electronics=Electronics(**electronics))
    return ReceiverEnd(receiver, name, RATE)(0, samples)


def silence() -> np.ndarray:
    return np.zeros(COUNT)


def assert_rms(samples: np.ndarray, wanted: float, correlated: float = 1.0) -> None:
    """Five deviations of the estimate of a variance, `correlated` samples long each; 1 dB more is 26 % more."""
    ratio = np.mean(samples**2) / wanted**2
    assert abs(ratio - 1.0) < 5 * np.sqrt(2 * correlated / len(samples))


def test_nothing_is_done_unless_it_is_asked_for(rng: np.random.Generator) -> None:
    samples = rng.normal(size=COUNT)
    np.testing.assert_array_equal(recorded(samples), samples)


@pytest.mark.parametrize("length", [1, 5, 700, 40_000])
def test_stream_filter_is_a_convolution_however_it_is_cut(length: int, rng: np.random.Generator) -> None:
    samples, taps = rng.normal(size=COUNT), rng.normal(size=length) / np.sqrt(length)
    whole = StreamFilter(taps, SEGMENT)(samples)
    before = np.pad(samples, (length - 1, 0))
    cuts = [np.arange(at - 9, at + 9) for at in (9, SEGMENT, 2 * SEGMENT, 3 * SEGMENT, COUNT - 9)]
    at = np.unique([*np.concatenate(cuts), *rng.integers(0, COUNT, 300)])
    np.testing.assert_allclose(whole[at], [before[n : n + length] @ taps[::-1] for n in at], atol=1e-12)
    pieces = StreamFilter(taps, SEGMENT)
    cut = [pieces(part) for part in np.split(samples, [SEGMENT, 3 * SEGMENT])]
    np.testing.assert_array_equal(np.concatenate(cut), whole)


def test_another_one_goes_on_from_a_state(rng: np.random.Generator) -> None:
    samples = 0.1 * rng.normal(size=COUNT)
    electronics = Electronics(
        ambient_noise_db=20.0, self_noise_db=30.0, seed=5, low_cut=20e3, high_cut=70e3, order=5, gain_db=60.0,
        adc_bits=12, adc_full_scale=1.0,
    )  # fmt: skip
    receiver = clsim.Receiver("r", PLACE, transducer=RESONANCE, electronics=electronics)
    whole, first, second = (ReceiverEnd(receiver, "r", RATE) for _ in range(3))
    wanted = whole(0, samples)
    first(0, samples[: 2 * SEGMENT])
    second.restore({name: value.copy() for name, value in first.state().items()})
    np.testing.assert_array_equal(second(2 * SEGMENT, samples[2 * SEGMENT :]), wanted[2 * SEGMENT :])
    assert second.clipped == whole.clipped > 0
    # Each part of the state counts.
    for name in first.state():
        if name != "clipped":
            other = ReceiverEnd(receiver, "r", RATE)
            other.restore(first.state() | {name: 0.0 * first.state()[name]})
            assert np.any(other(2 * SEGMENT, samples[2 * SEGMENT :]) != wanted[2 * SEGMENT :]), name


def test_pieces_begin_at_whole_chunks() -> None:
    room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.5))
    tone = clsim.Signal.tone(40e3, duration=0.3, sampling_rate=RATE, fade=0.002)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((2, 2, 2)))
    scene = clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("r", PLACE)])
    plan = clsim.plan_render(clsim.find_paths(scene, 0), RATE, engine="reference", chunk=SEGMENT)
    pieces = list(clsim.render_chunks(plan))
    later = list(clsim.render_chunks(plan, first=SEGMENT))
    assert [start for start, _ in later] == [start for start, _ in pieces[1:]]
    for (_, one), (_, other) in zip(later, pieces[1:], strict=True):
        np.testing.assert_array_equal(one, other)
    assert list(clsim.render_chunks(plan, first=plan.samples)) == []
    for first in (1, -SEGMENT, plan.samples + SEGMENT, 0.5):
        with pytest.raises(InputError, match="first"):
            list(clsim.render_chunks(plan, first=first))


def test_ambient_noise_has_its_density() -> None:
    # 34 dB re 20 µPa/√Hz are 1.0024 mPa/√Hz; times the root of 96 kHz.
    got = recorded(silence(), ambient_noise_db=34.0, seed=1)
    assert_rms(got, 20e-6 * 10 ** (34 / 20) * np.sqrt(96e3))
    power = np.abs(np.fft.rfft(got)) ** 2 / COUNT
    for part in np.array_split(power[1:-1], 4):  # white: the same in every quarter of the band
        assert_rms(np.sqrt(part), 20e-6 * 10 ** (34 / 20) * np.sqrt(96e3))


def test_ambient_noise_passes_the_transducer() -> None:
    taps = RESONANCE.impulse_response(RATE)
    got = recorded(silence(), transducer=RESONANCE, ambient_noise_db=34.0)[len(taps) :]
    # The variance of filtered noise is known within 2 / N times the sum of its squared correlations.
    correlation = np.correlate(taps, taps, "full") / (taps @ taps)
    wanted = 20e-6 * 10 ** (34 / 20) * np.sqrt(96e3) * np.linalg.norm(taps)
    assert_rms(got, wanted, float(correlation @ correlation))


def test_self_noise_is_told_where_the_transducer_is_most_sensitive() -> None:
    got = recorded(silence(), transducer=RESONANCE, self_noise_db=20.0)
    assert_rms(got, 0.007 * 20e-6 * 10 * np.sqrt(96e3))


def test_signal_to_noise_ratio_is_to_the_level_that_is_told() -> None:
    assert_rms(recorded(silence(), snr_db=20.0, reference_level_db=94.0), 20e-6 * 10 ** (74 / 20))


def test_noise_is_the_same_for_the_same_seed_and_name_only() -> None:
    one = recorded(silence(), ambient_noise_db=0.0, seed=1)
    np.testing.assert_array_equal(one, recorded(silence(), ambient_noise_db=0.0, seed=1))
    for other in (
        recorded(silence(), ambient_noise_db=0.0, seed=2),
        recorded(silence(), name="other", ambient_noise_db=0.0, seed=1),
        recorded(silence(), self_noise_db=0.0, seed=1),
        one[::-1],
    ):
        assert abs(np.corrcoef(one, other)[0, 1]) < 5 / np.sqrt(COUNT)


@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize(("cut", "kind"), [("low_cut", "highpass"), ("high_cut", "lowpass")])
def test_cuts_are_butterworth_filters(order: int, cut: str, kind: str) -> None:
    impulse = silence()
    impulse[0] = 1.0
    spectrum = np.fft.rfft(recorded(impulse, order=order, **{cut: 20e3})[:19200])  # bins of 10 Hz
    assert abs(spectrum[2000]) == pytest.approx(np.sqrt(0.5), rel=1e-6)
    # Warped frequencies: |H|² = 1 / (1 + (tan(w/2) / tan(w0/2))^(2 order)), or with the ratio turned round.
    ratio = np.tan(np.pi * 30 / 192) / np.tan(np.pi * 20 / 192)
    wanted = (1 + (ratio if kind == "lowpass" else 1 / ratio) ** (2 * order)) ** -0.5
    assert abs(spectrum[3000]) == pytest.approx(wanted, rel=1e-6)
    assert butter(order, 20e3, kind, fs=RATE, output="sos").shape[0] == -(-order // 2)


def test_gain() -> None:
    np.testing.assert_allclose(recorded(np.ones(10), gain_db=40.0), 100.0, rtol=1e-12)


def test_converter_rounds_to_whole_steps_and_clips() -> None:
    bits, step = 4, 0.125  # codes -8 to 7, full scale 1
    ramp = np.linspace(-2.0, 2.0, 4001)
    receiver = clsim.Receiver("r", PLACE, electronics=Electronics(adc_bits=bits, adc_full_scale=1.0))
    end = ReceiverEnd(receiver, "r", RATE)
    got = end(0, ramp)
    assert set((got / step).tolist()) == set(range(-8, 8))
    inside = (ramp > -1.0) & (ramp < 0.9)
    assert np.abs(got - ramp)[inside].max() == pytest.approx(step / 2, rel=1e-2)
    assert np.abs(got - ramp)[inside].max() <= step / 2 * (1 + 1e-12)
    # Clipped is what rounds to -9 or less, or to 8 or more: below -8.5 and from 7.5 steps on (a half goes to even).
    assert end.clipped == np.count_nonzero(ramp < -8.5 * step) + np.count_nonzero(ramp >= 7.5 * step)
    # Its error is a uniform distribution's: step / sqrt(12), within a per cent on a fine ramp.
    assert np.std((got - ramp)[inside]) == pytest.approx(step / np.sqrt(12), rel=0.01)


BAD = {
    "ambient_noise_db": {"ambient_noise_db": np.nan},
    "snr_db": {"snr_db": 10.0, "reference_level_db": 90.0, "ambient_noise_db": 0.0},
    "reference_level_db": {"snr_db": 10.0},
    "self_noise_db": {"self_noise_db": "loud"},
    "seed": {"seed": -1},
    "low_cut": {"low_cut": 0.0},
    "high_cut": {"low_cut": 50e3, "high_cut": 40e3},
    "order": {"order": 9},
    "gain_db": {"gain_db": 500.0},
    "adc_bits": {"adc_full_scale": 1.0},
    "adc_full_scale": {"adc_bits": 12},
    "clock_ppm": {"clock_ppm": 1e5},
    "clock_offset": {"clock_offset": 2.0},
}


@pytest.mark.parametrize("field", BAD)
def test_bad_input_names_the_field(field: str) -> None:
    with pytest.raises(InputError) as caught:
        Electronics(**BAD[field])
    assert caught.value.field == field


def test_more_bad_input() -> None:
    with pytest.raises(InputError, match="adc_bits: must be from 1 to 24"):
        Electronics(adc_bits=25, adc_full_scale=1.0)
    with pytest.raises(InputError, match="electronics: must be Electronics"):
        clsim.Receiver("r", PLACE, electronics={"gain_db": 1.0})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="high_cut: must be below 96000 Hz"):
        recorded(silence(), high_cut=96e3)
