"""Channels in complex baseband against the baseband rendering, and against each other."""

import numpy as np
import pytest

import clsim

RATE, CARRIER, BAND = 192e3, 40e3, 4e3
LENGTH = 0.03  # s


@pytest.fixture(scope="module")
def paths() -> clsim.PathSet:
    """Return two sources, of which one moves and turns its beam, and walls that ring, are porous or turn the phase."""
    walls = {
        "default": clsim.Material.from_reflection(0.8),
        "z_min": clsim.Material.from_impedance([30e3, 50e3], [3.0 - 2.0j, 1.5 - 0.5j], outside="hold"),
        "x_max": clsim.Material.from_absorption([30e3, 38e3, 50e3], [0.1, 0.6, 0.3]),
    }
    chirp = clsim.Signal.chirp(38.9e3, 41.1e3, LENGTH, RATE, window="hann")
    move = clsim.Trajectory.line((1, 1, 1), (1.2, 1.1, 1), 0.1)
    sources = [
        clsim.Source("robot", chirp, move, directivity=clsim.Piston(0.01), aim=(1, 0.2, 0.1)),
        clsim.Source("beacon", chirp, clsim.Trajectory.fixed((3, 2.5, 2))),
    ]
    ears = [clsim.Receiver("left", clsim.Trajectory.line((3, 1, 2), (3, 1.3, 2), 0.1)),
            clsim.Receiver("right", clsim.Trajectory.fixed((2, 2, 0.5)))]  # fmt: skip
    return clsim.find_paths(clsim.Scene(clsim.Shoebox((4, 3, 2.5), walls), clsim.Air(), sources, ears), 1)


def envelope(signal: clsim.Signal, rate: float, count: int) -> np.ndarray:
    """Return the complex envelope of a signal about the carrier at a lower rate, all but the band left out."""
    whole = 2 * int(count * RATE / rate)
    spectrum = np.fft.fft(signal.read(0, whole))
    frequencies = np.fft.fftfreq(whole, 1.0 / RATE)
    kept = round(whole * rate / RATE)
    shifted = np.roll(
        np.where(np.abs(frequencies - CARRIER) <= 0.5 * rate, spectrum, 0.0), -round(CARRIER * whole / RATE)
    )
    narrow = np.concatenate([shifted[: kept // 2], shifted[-(kept // 2) :]])
    return np.fft.ifft(narrow)[:count] * 2.0 * rate / RATE


def test_taps_filter_as_the_baseband_rendering_does(paths: clsim.PathSet, measured) -> None:
    """Every sample by its own taps: what is left out of the band is below -60 dB, and so is the difference."""
    rendered = clsim.render(paths, sampling_rate=RATE, baseband=(CARRIER, BAND, 6e3), duration=0.04)
    rate, count = rendered.sampling_rate, rendered.samples.shape[1]
    sent = envelope(paths.scene.sources[0].signal, rate, count)
    found = paths.taps(rendered.times, carrier=CARRIER, bandwidth=BAND, sampling_rate=rate)
    assert found.gain.shape[:2] == (2, 2)
    first = round(found.delays[0] * rate)
    padded = np.pad(sent, (found.gain.shape[2], found.gain.shape[2]))
    heard = np.zeros((2, count), dtype=complex)
    for n in range(count):
        past = padded[n - first + found.gain.shape[2] - np.arange(found.gain.shape[2])]
        heard[:, n] = np.einsum("srl,l->r", found.gain[..., n], past)
    for row, wanted in zip(heard, rendered.samples, strict=True):
        found_db = 20 * np.log10(np.linalg.norm(row - wanted) / np.linalg.norm(wanted))
        measured("taps of channels", "baseband rendering", found_db, -60.0)


def test_taps_of_a_tone_are_the_paths(paths: clsim.PathSet) -> None:
    """At the carrier, taps add up to the gains of all paths; elsewhere in the band to those with that frequency's phase."""
    times = np.array([0.01, 0.0333, 0.05])
    rays = paths.cir(times, carrier=CARRIER)
    for bandwidth, rate in ((2e3, 2.5e3), (10e3, 20e3)):
        taps = paths.taps(times, carrier=CARRIER, bandwidth=bandwidth, sampling_rate=rate)
        for s, r in np.ndindex(2, 2):
            mine = (rays.source == s) & (rays.receiver == r)
            np.testing.assert_allclose(
                taps.gain[s, r].sum(axis=0), rays.gain[mine].sum(axis=0), rtol=0,
                atol=5e-5 * np.abs(rays.gain[mine]).max(),
            )  # fmt: skip
    off = 3.7e3
    elsewhere = paths.cir(times, carrier=CARRIER + off)
    turned = np.einsum("l,srlt->srt", np.exp(-2j * np.pi * off * taps.delays), taps.gain)
    for s, r in np.ndindex(2, 2):
        mine = elsewhere.gain[(rays.source == s) & (rays.receiver == r)]
        np.testing.assert_allclose(turned[s, r], mine.sum(axis=0), rtol=0, atol=5e-5 * np.abs(mine).max())


def test_paths_have_absolute_delays_and_their_table_s_gains(paths: clsim.PathSet) -> None:
    times = np.array([0.01, 0.05])
    rays, table = paths.cir(times, carrier=CARRIER), paths.table(times)
    np.testing.assert_array_equal(rays.delay, table.delay)
    np.testing.assert_allclose(rays.gain * np.exp(2j * np.pi * CARRIER * rays.delay), table.gain, rtol=1e-7, atol=1e-12)
    points = paths.delay_doppler(0.02, 0.04, carrier=CARRIER)
    middle, ends = paths.table([0.04]), paths.table([0.02, 0.06])
    np.testing.assert_array_equal(points.delay, middle.delay[:, 0])
    np.testing.assert_allclose(points.doppler_shift, middle.doppler_shift[:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(points.delay_change, np.diff(ends.delay)[:, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(points.doppler_change, np.diff(ends.doppler_shift)[:, 0], rtol=0, atol=1e-6)
    # Over a time in which little changes, the phase of the gain turns by the Doppler shift.
    short = paths.cir([0.04, 0.04 + 1e-6], carrier=CARRIER).gain
    turned = np.angle(short[:, 1] / short[:, 0]) / (2e-6 * np.pi)
    np.testing.assert_allclose(turned, points.doppler_shift, rtol=0, atol=1.0)
    assert np.abs(points.doppler_shift).max() > 100.0


def test_silent_paths_and_names() -> None:
    pytest.importorskip("xarray")
    wall = clsim.Material.from_reflection(0.0)
    screen = clsim.MeshRoom([(2, 1, 0), (2, 2, 0), (2, 2, 2.5), (2, 1, 2.5)], [(0, 1, 2), (0, 2, 3)], wall)
    room = clsim.MeshRoom.joined([clsim.Shoebox((4, 3, 2.5), wall), screen])
    tone = clsim.Signal.tone(CARRIER, 0.5, RATE)
    source = clsim.Source("s", tone, clsim.Trajectory.line((1, 0.5, 1), (1, 2.5, 1), 1.0))
    scene = clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("r", clsim.Trajectory.fixed((3, 1.0, 1)))])
    paths = clsim.find_paths(scene, 0, engine="reference")
    times = np.array([0.05, 0.8])
    rays = paths.cir(times, carrier=CARRIER).to_xarray()
    assert (rays.gain != 0.0).values.tolist() == [[True, False]]
    assert np.isnan(rays.delay.values).tolist() == [[False, True]]
    assert rays.source.values.tolist() == ["s"]
    taps = paths.taps(times, carrier=CARRIER, bandwidth=2e3, sampling_rate=4e3).to_xarray()
    assert taps.gain.dims == ("source", "receiver", "tap", "times")
    assert np.abs(taps.gain.sel(source="s", receiver="r")).max("tap").values[1] == 0.0
    assert taps.attrs["sampling_rate"] == 4e3
    first, rate = int(taps.tap[0]), 4e3
    assert first <= 0
    loudest = int(taps.tap[np.abs(taps.gain.values[0, 0, :, 0]).argmax()])
    assert abs(loudest - float(rays.delay[0, 0]) * rate) <= 0.5  # absolute


def test_what_no_channel_is_taken_at_is_refused(paths: clsim.PathSet) -> None:
    for given, message in (
        (
            {"sampling_rate": 4.9e3},
            r"sampling_rate: must be at least 1.25 times the bandwidth, 5000 Hz, but is 4900 Hz",
        ),
        ({"carrier": 1e3}, r"carrier: must be above half the bandwidth, 2000 Hz, but is 1000 Hz"),
        ({"times": []}, r"times: must be one at least|times: .*"),
        ({"motion": "fast"}, r"motion: must be one of"),
        ({"times": np.zeros(3_000_000), "bandwidth": 8e3, "sampling_rate": 10e3}, r"times: must give at most 8 GiB"),
    ):
        usual = {"times": [0.0], "carrier": CARRIER, "bandwidth": BAND, "sampling_rate": 6e3}
        with pytest.raises(clsim.InputError, match=message):
            paths.taps(**(usual | given))
