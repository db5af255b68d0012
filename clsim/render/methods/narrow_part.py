"""Narrow parts: the choice of bands that are rendered as complex envelopes, by their cost, and their contribution."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.blas import with_blas_threads
from clsim.render.baseband import CYCLES, USUAL, WIDEST, Baseband, blocks_of
from clsim.render.contributions import Stateless, digest_of
from clsim.render.envelope import LEVEL_TIME, NarrowBand, Split
from clsim.render.interpolator import Bandlimited
from clsim.render.methods.costs import measured_costs, on_gpu, passes, passing_times
from clsim.render.methods.narrow_spread import BETA, spread
from clsim.render.methods.per_sample import PathSum
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.block_polynomials import GAIN_ERROR
from clsim.render.plan import NarrowPart, Plan
from clsim.render.source_filters import Emission
from clsim.scene.signal.occupied_bandwidth import ShortTimeSpectra, shares
from clsim.scene.signal.signal import Signal
from clsim.scene.signal.waveforms import Chirp
from clsim.tracks.tracks import SceneTracks, Tracks

_PASSED_OVER = 1e-6  # of a window's energy, above what Hann's window adds: some windows pass over parts of a sweep
# Processor time of filtering by the functions of a few paths by scatterers, ns in a sample of the sound (12 capsules).
_STREAMS = 150.0
_AHEAD = 64  # samples of the envelope before the first one of the sound: for upsampling, in whole subblocks


@dataclass(frozen=True, slots=True, eq=False)
class NarrowParts:
    """Contribution of the signals that are rendered as envelopes and upsampled."""

    plan: Plan  # of the whole
    name: ClassVar[str] = "narrow parts"

    def describe(self) -> list[str]:
        return [line for part in self.plan.allocation.narrow for line in _described(part)]

    def digest(self) -> str:
        found = list[Any]()
        for part in self.plan.allocation.narrow:
            options = repr((part.plan.baseband, part.sources))
            found += [options, part.upsampler.taps, PathSum(part.plan).digest()]
        return digest_of(*found)

    def begin(self) -> _Adding:
        return _Adding(self.plan.allocation.narrow)


def _described(part: NarrowPart) -> list[str]:
    baseband, summed, lines = part.plan.baseband, PathSum(part.plan), []
    assert baseband is not None
    for i in part.sources:
        filters, here = part.plan.source_filters[i], f"source {i}, narrow part"
        reach = (filters.half_length + part.upsampler.reach) / part.plan.sampling_rate
        lines += [
            f"{here}: rendered as complex envelope of {baseband.bandwidth:.0f} Hz about {baseband.carrier:g} Hz at "
            f"{part.plan.sampling_rate:.6g} Hz; it sounds up to {1e3 * reach:.3g} ms before an arrival",
            f"{here}: {filters.describe_filters()}",
            f"{here}: {filters.describe()}",
            f"{here}: total error at most {summed.promised_db(i):.0f} dB of the level received within 40 ms",
        ]
    return lines


class _Adding(Stateless):
    """Adds all narrow parts."""

    def __init__(self, parts: tuple[NarrowPart, ...]) -> None:
        self.engines = self._parts = [_Upsampled(part) for part in parts]

    def add(self, pressure: NDArray[Any], start: int) -> None:
        with with_blas_threads(1):
            for part in self._parts:
                part.add(pressure, start)

    def shared(self, first: int, last: int) -> list[str]:
        return [f"{i}.{k}" for i, part in enumerate(self._parts) for k in part.chunks(first, last)]

    def made(self, name: str) -> NDArray[Any]:
        part, chunk = map(int, name.split("."))
        with with_blas_threads(1):
            return self._parts[part].rendered(chunk, alone=True)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        def found(part: int, chunk: int) -> NDArray[Any]:
            return find(f"{part}.{chunk}")

        for i, part in enumerate(self._parts):
            part.found = partial(found, i)


class _Upsampled:
    """Envelopes of one narrow part, chunk by chunk of their own, and the sound that is made of them."""

    def __init__(self, part: NarrowPart) -> None:
        self.found: Callable[[int], Complexes] = self.rendered
        self._plan, self._upsampler = part.plan, part.upsampler
        self._engine: BasebandEngine | None = None
        self._chunks: dict[int, Complexes] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        envelopes = self._envelopes(*self._span(start, start + pressure.shape[1]))
        first, skipped = divmod(start, self._upsampler.every)
        self._upsampler.add(envelopes, first, pressure, skipped)

    def warn(self) -> None:
        if self._engine is not None:
            self._engine.warn()

    def chunks(self, start: int, stop: int) -> range:
        """Return the chunks of envelopes that samples `start` to `stop` of the sound are made of."""
        return self._chunks_of(*self._span(start, stop))

    def _span(self, start: int, stop: int) -> tuple[int, int]:
        """Return the first and last samples of the envelopes that samples of the sound need."""
        every, reach = self._upsampler.every, self._upsampler.reach
        return start // every + 1 - reach, -(-stop // every) + reach

    def _chunks_of(self, first: int, last: int) -> range:
        size = self._plan.chunk
        return range((first + _AHEAD) // size, (last - 1 + _AHEAD) // size + 1)

    def _envelopes(self, first: int, last: int) -> Complexes:
        """Return samples `first` to `last` of the envelopes, (receivers, n)."""
        wanted = self._chunks_of(first, last)
        self._chunks = {k: self._chunks[k] if k in self._chunks else self.found(k) for k in wanted}
        begin, made = wanted[0] * self._plan.chunk - _AHEAD, list(self._chunks.values())
        together = made[0] if len(made) == 1 else np.concatenate(made, axis=1)
        return together[:, first - begin : last - begin]

    def rendered(self, chunk: int, *, alone: bool = False) -> Complexes:
        """Return a chunk of envelopes, the same from any beginning; `alone` if the next one need not be prepared."""
        if self._engine is None:
            self._engine = BasebandEngine(self._plan)
        start = chunk * self._plan.chunk - _AHEAD
        stop = min(start + self._plan.chunk, self._plan.samples)
        if alone:
            self._engine.until(stop)
        return self._engine.render(start, stop)


_SHARES = (1e-3, 1e-6, 1e-9, 1e-11)  # of the energy to either side of what is passed as it is
_SKIRTS = (1e3, 2e3, 4e3)  # Hz, over which the band-pass falls
_MOST_BANDS = 6
_LENGTHENED = 0.17  # of the cost of upsampling, times the rate over what bands leave of it
_BINS, _SHARP_BINS = 10.0, 1.0  # added to bands: of short-time spectra what a tone spreads in them, of others the step
_LEAST_EVERY = 2  # samples of the sound in one of the envelope: up to there the cost decides
_WINDOWS, _ENDS = 8, 4  # windows of a signal that are looked at for silence of the rest, and more at either end
_MOST_PAIRS = 4  # whose motion is looked at


@dataclass(frozen=True, slots=True, eq=False)
class NarrowOffer:
    """Bands of one source's signal that can be rendered as complex envelopes, and what that costs."""

    split: Split  # the bands, and the rest of the signal
    cost: float  # processor time of the envelopes and of the rest of a path in a sample of the sound, ns


def cheapest_split(emission: Emission, pairs: list[int], known: Split | None = None) -> tuple[Split | None, str]:
    """Return the cheapest split into narrow bands and a rest, or a `known` one, or None; and why there is none."""
    if known is not None and _suits(emission, pairs):
        known = _received(emission, pairs, known.within(emission.options.interpolator.error_db))
        if known is not None and can(emission, pairs, known) is None:
            return known, ""
    best = min(offers(emission, pairs), key=lambda offer: offer.cost, default=None)
    if best is None or (best.cost > emission.cost_of_whole() and not emission.options.narrowband):
        return None, ""
    why = can(emission, pairs, best.split)
    if why is None:
        return best.split, ""
    return None, f"source {emission.source}: rendered as a whole, without a narrow part: {why}"


def offers(emission: Emission, pairs: list[int]) -> list[NarrowOffer]:
    """Return splits of a source's signal into narrow bands and a rest, for some of its pairs: none if none can pay."""
    signal, sound, tracks = emission.signal, emission.sound, emission.tracks
    if not _suits(emission, pairs):
        return []
    of_band, of_all = _costs(emission, pairs)
    rate, error_db = signal.sampling_rate, emission.options.interpolator.error_db
    some, inner = _some(signal)
    some = some if len(some.energy) else sound  # a train's pauses
    steady = None if isinstance(signal.waveform, Chirp) else inner  # windows do not tell of others of a sweep
    spectra = [(each, width) for each, width in ((sound, _BINS), (inner, _SHARP_BINS)) if len(each.energy)]
    motion, work = (emission.max_rate, _width_of_fades(tracks, pairs, error_db)), _work(emission, pairs)
    sets = dict.fromkeys(bands for each in spectra for bands in _band_sets(signal, *each, *motion, work))
    costs = {bands: of_all + sum(of_band + _envelope_cost(band, rate) for band, *_ in bands) for bands in sets}
    found: list[NarrowOffer] = []
    for bands in sorted(sets, key=costs.__getitem__):
        if costs[bands] >= min((offer.cost for offer in found), default=math.inf):
            break
        split = Split.into(tuple(NarrowBand.designed(*band, rate, error_db) for band in bands), error_db, steady)
        loud = max(_share(split.loud_in(some), some), _share(split.loud_in(sound, _PASSED_OVER), sound))
        found.append(NarrowOffer(split, costs[bands] + emission.cost_of_rest(loud)))
    return found


def _received(emission: Emission, pairs: list[int], split: Split) -> Split | None:
    """Return a split whose envelopes are as wide as the motion of some pairs asks for; None where that is too much."""
    fades, bands = _width_of_fades(emission.tracks, pairs, emission.options.interpolator.error_db), []
    motion = emission.max_rate, fades, _work(emission, pairs)
    for band in split.bands:
        baseband = _baseband(emission.signal, band.baseband.carrier, band.flat, band.half, *motion)
        if baseband is None:
            return None
        bands.append(replace(band, baseband=baseband))
    return replace(split, bands=tuple(bands))


def _suits(emission: Emission, pairs: list[int]) -> bool:
    """Test whether narrow bands are allowed, and one of them may pay for some pairs of a source."""
    options = emission.options
    usable = options.narrowband is not False and options.baseband is None and options.engine == "opencl"
    if not (usable and isinstance(options.interpolator, Bandlimited) and pairs and len(emission.sound.energy)):
        return False
    if emission.tracks.of_scene is None:
        return False
    return bool(options.narrowband) or sum(_costs(emission, pairs)) <= emission.cost_of_whole()


def _work(emission: Emission, pairs: list[int]) -> tuple[float, int]:
    """Numbers of paths, of which a GPU takes many as one, and of pairs."""
    gpu = measured_costs().gpu if on_gpu(emission.options) else 1.0
    return _active_paths(emission.tracks, pairs, emission.until) / gpu, len(pairs)


def _costs(emission: Emission, pairs: list[int]) -> tuple[float, float]:
    """Processor time of a path in a sample of the sound, ns: of upsampling a band for pairs, and of the split."""
    known, signal = measured_costs(), emission.signal
    samples = min(signal.duration, emission.until) * signal.sampling_rate
    path_samples = max(_work(emission, pairs)[0] * samples, 1.0)
    per_sample = known.split - (_STREAMS if emission.filters_more else 0.0)
    return samples * known.upsampled * len(pairs) / path_samples, (known.planned + samples * per_sample) / path_samples


def _share(loud: NDArray[np.bool_], sound: ShortTimeSpectra) -> float:
    """Share of the time of a sound that is in some of its windows (W,)."""
    return float(sound.weights[loud].sum() / sound.weights.sum())


def _envelope_cost(band: Baseband, rate: float) -> float:
    """Return the processor time of a path's envelope in a sample of the sound, ns."""
    known = measured_costs()
    return known.nodes + known.envelope * (band.sampling_rate or rate) / rate


def _cost_at(band: Baseband, half: float, rate: float, paths: float, pairs: int) -> float:
    """Return the processor time of envelopes by what depends on their rate, ns in a second.

    Filters are the longer the nearer the ends are to half the rate: for delays those at `half` Hz, for upsampling to a
    `rate`, Hz, those of what is received.
    """
    known, own = measured_costs(), band.sampling_rate or rate
    edge, width = 2.0 * half / own, band.bandwidth / own
    summed = own * (paths * known.envelope + known.branches * edge / (1.0 - edge))
    return summed + rate * pairs * known.upsampled * _LENGTHENED / (1.0 - width)


def can(emission: Emission, pairs: list[int], split: Split) -> str | None:
    """Return the reason against envelopes at a low rate for the pairs of a source; None if there is none."""
    assert emission.tracks.of_scene is not None, "offers are made for scenes"
    span = emission.start, emission.start + emission.signal.duration, emission.until
    about = emission.source, emission.max_rate
    reasons = (_obstacle(about, emission.tracks.of_scene, pairs, band, split.silence, span) for band in split.bands)
    return next(filter(None, reasons), None)


def _active_paths(tracks: Tracks, mine: list[int], until: float) -> float:
    """Return the mean number of active paths of some pairs until the end of the run, s."""
    times = (np.clip([tracks.pairs[i].start, tracks.pairs[i].end], 0.0, until) for i in mine)
    return float(sum((end - start).sum() for start, end in times)) / until


def _width_of_fades(tracks: Tracks, mine: list[int], error_db: float) -> float:
    """Return the half width to which paths that begin and end spread a tone, within an error, Hz; 0 for none.

    The energy spectrum of a raised cosine over T is that of a step, ``1 / (2 pi f)^2``, times ``cos(pi f T)^2 /
    (1 - (2 f T)^2)^2``: beyond F there are ``1 / (320 pi^2 T^4 F^5)`` to either side together, which must be below the
    asked error in what sounds within 20 ms even if all paths begin at once.
    """
    if tracks.transition == 0.0 or not any(tracks.pairs[i].fades for i in mine):
        return 0.0
    return float((320.0 * math.pi**2 * tracks.transition**4 * LEVEL_TIME * 10 ** (error_db / 10)) ** -0.2)


def _band_sets(
    signal: Signal, sound: ShortTimeSpectra, bins: float, max_rate: float, fades: float, work: tuple[float, int]
) -> Iterator[tuple[tuple[Baseband, float, float], ...]]:
    """Yield bands that may hold most of a sound, each with the ends of what is passed as it is, and at all, Hz.

    work: numbers of paths and of pairs.
    """
    spread, spectrum = bins * float(sound.frequencies[1]), (sound.frequencies, sound.weights @ sound.energy)
    for share, skirt in itertools.product(_SHARES, _SKIRTS):
        for ranges in ([shares(spectrum, share)], _ranges(spectrum, share, 2.0 * (spread + skirt))):
            bands = [_band(signal, *ends, spread, skirt, max_rate, fades, work) for ends in ranges]
            found = tuple(band for band in bands if band is not None)
            if 0 < len(found) == len(ranges):
                yield found


def _ranges(spectrum: tuple[Floats, Floats], share: float, apart: float) -> list[tuple[float, float]]:
    """Return ranges so far apart that hold all but twice a share of the energy, Hz; none where they are one or many."""
    frequencies, energy = spectrum
    order = np.argsort(energy)
    loud = frequencies[np.sort(order[np.cumsum(energy[order]) > 2.0 * share * energy.sum()])]
    gaps = np.flatnonzero(np.diff(loud) > apart)
    if not 0 < len(gaps) < _MOST_BANDS:
        return []
    return list(zip(loud[np.r_[0, gaps + 1]].tolist(), loud[np.r_[gaps, len(loud) - 1]].tolist(), strict=True))


def _band(
    signal: Signal, low: float, high: float, spread: float, skirt: float, max_rate: float, fades: float,
    work: tuple[float, int],
) -> tuple[Baseband, float, float] | None:  # fmt: skip
    """Return a band for what is emitted in a range, with the ends of what is passed as it is, and at all, or None."""
    carrier = float(round(0.5 * (low + high)))
    if abs(signal.centre_frequency - carrier) < spread:
        carrier = signal.centre_frequency
    flat = 0.5 * (high - low) + spread
    half = flat + skirt
    baseband = _baseband(signal, carrier, flat, half, max_rate, fades, work)
    return None if baseband is None else (baseband, flat, half)


def _baseband(
    signal: Signal, carrier: float, flat: float, half: float, max_rate: float, fades: float, work: tuple[float, int]
) -> Baseband | None:
    """Return the envelope of what is emitted about a carrier; None where that is too wide.

    Its rate is the cheaper one for so many paths and pairs (`work`): low, or so high that filters are short.
    """
    rate = signal.sampling_rate
    # All that is emitted is received within the width, and at the rate what transitions spread.
    width, emitted = (2.0 * (x * (1.0 + max_rate) + carrier * max_rate) for x in (half, flat))
    found = []
    for widest in (WIDEST, USUAL):
        held = max(width, widest * (emitted + 2.0 * fades))
        every = math.floor(rate / max(held / widest, carrier / CYCLES))
        if every >= _LEAST_EVERY and held <= min(carrier, rate - 2.0 * carrier):
            found.append(Baseband(carrier, held, rate / every))
    return min(found, key=lambda band: _cost_at(band, half, rate, *work), default=None)


def _some(signal: Signal) -> tuple[ShortTimeSpectra, ShortTimeSpectra]:
    """Return some windows of a signal, relative to their own energy, and those of them that are not at its ends.

    Hann's window would show skirts of -90 dB beside a wide band, which it makes itself.
    """
    length = 2 ** round(math.log2(2.0 * LEVEL_TIME * signal.sampling_rate))
    last, hop, window = -(-signal.count // (length // 2)), length // 2, np.kaiser(length, BETA)
    inner = np.random.default_rng(0).integers(_ENDS, max(last - _ENDS, _ENDS + 1), _WINDOWS)
    picked = np.unique(np.clip(np.r_[-1 : _ENDS - 1, inner, last - _ENDS : last], -1, last - 1)).tolist()
    spectra = [np.abs(np.fft.rfft(signal.read(k * hop, k * hop + length) * window)) ** 2 for k in picked]
    levels, weights = np.array([each.sum() for each in spectra]), np.gradient([*picked, last])[:-1]
    loud = levels > 0.0
    energy = np.array(spectra)[loud] / levels[loud, None]
    within, weights = np.isin(picked, inner)[loud], weights[loud]
    frequencies: Floats = np.arange(hop + 1) * (signal.sampling_rate / length)
    all_of_them = ShortTimeSpectra(frequencies, energy, weights)
    return all_of_them, ShortTimeSpectra(frequencies, energy[within], weights[within])


def _obstacle(
    about: tuple[int, float], tracks: SceneTracks, mine: list[int], narrow: NarrowBand, silence: float,
    span: tuple[float, float, float],
) -> str:  # fmt: skip
    """Return the reason against an envelope at a low rate; "" if there is none. Levels below `silence` are neglected.

    About the source's index and a bound of the rate of its delays. The span is when the signal begins and ends and when
    the run ends, s.
    """
    scene, (index, max_rate) = tracks.paths.scene, about
    if tracks.transition == 0.0 and any(tracks.pairs[i].fades for i in mine):
        return "paths begin and end at once"
    receivers = sorted({tracks.pairs[i].receiver for i in mine})
    ends = [("the source", scene.sources[index].trajectory)]
    ends += [(f"receiver {i}", scene.receivers[i].trajectory) for i in receivers]
    ends += [(f"scatterer {i}", scatterer.trajectory) for i, scatterer in enumerate(scene.scatterers)]
    ends += [(f"body {i}", body.trajectory) for i, body in enumerate(scene.bodies)]
    for what, trajectory in ends:
        turning = trajectory.turning if what.startswith("body") else None
        if len(trajectory.breaks) or (turning is not None and len(turning.breaks)):
            return f"the velocity of {what} jumps"
    # Passing an end at a distance d with a speed v spreads a tone by its Doppler shift D and beyond, at an offset f, by
    # exp(-2 pi sqrt(f^2 - D^2) d / v): the phase k sqrt(d^2 + v^2 t^2) has branch points at +-j d / v.
    skirt, carrier = narrow.half - narrow.flat, narrow.baseband.carrier
    shift = carrier * max_rate
    needed = -math.log(silence) / (2.0 * math.pi * math.sqrt(skirt * (skirt + 2.0 * shift)))
    # In the shortest blocks cubics must hold 1 / sqrt(d^2 + v^2 t^2), whose fourth derivative is 9 (v / d)^4 over d.
    rate = narrow.baseband.sampling_rate or 0.0
    shortest = blocks_of(rate, carrier, max_rate)[-1] / rate
    needed = max(needed, shortest * (9.0 * GAIN_ERROR[8] / silence) ** 0.25)
    for what, ends_of, most, radius in passes(tracks, index, receivers):
        if most > 0.0 and len(passing_times(ends_of, span[2], needed, most, radius)):
            return f"{what} is passed so near, at up to {most:.3g} m/s, that its sound is not narrow"
    # Shadows spread no more than the echoes of what casts them.
    varied = [i for i in mine if not tracks.pair_paths[i].family.adds]
    some = varied[:: -(-len(varied) // _MOST_PAIRS) or 1]
    if any(spread(tracks, i, narrow, span, max_rate) > silence for i in some):
        return "ends move so quickly that the received band is not narrow"
    return ""
