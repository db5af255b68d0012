"""Errors of renderings at default settings, against an oracle of its own: listed scenes, and 100 drawn ones.

At every change a tenth of the drawn ones, and few of those that differ in a rate or a speed.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace

import default_oracle as oracle
import numpy as np
import pytest
from default_cases import (
    C,
    Case,
    Figures,
    abrupt_tones,
    band_limits,
    circles,
    drawn,
    fast_ends,
    near_and_far,
    near_and_fast,
    pairs_at_rest,
    pressures,
    wide_bands,
)
from default_cases import measured as figures_of
from default_oracle import Emitted, Fineness, Line, Room
from exhaustive import few
from scipy.signal import firwin

import clsim
from clsim.errors import ClsimWarning, InputError

PROMISED_DB = -85.0  # of all that is heard
pytestmark = [
    pytest.mark.usefixtures("device"),
    pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning"),  # signals that begin at once
]


def check(figures: Figures) -> None:
    assert figures.error_db <= PROMISED_DB


def named(cases: list[Case]) -> list[object]:
    return [pytest.param(case, id=case.name) for case in cases]


def shortened(case: Case, duration: float) -> Case:
    """Return a case of which only the beginning is rendered, and compared at fewer samples."""
    return replace(case, options={**case.options, "duration": duration}, samples=640)


LISTED = [
    shortened(circles()[1], 0.1), *(shortened(case, 0.04) for case in abrupt_tones()[1:]),
    *(replace(case, samples=640) for case in pairs_at_rest()), *wide_bands(0.06),
]  # fmt: skip


@pytest.mark.parametrize("case", named(LISTED))
def test_listed_scenes(case: Case, measured: Callable[..., float]) -> None:
    error_db = figures_of(case).error_db
    measured("accuracy of default calls", "float64 oracle of its own", error_db, PROMISED_DB)


@pytest.mark.parametrize("case", few(named(near_and_far(0.25))))
def test_every_20_ms_is_as_right(case: Case, measured: Callable[..., float]) -> None:
    figures = figures_of(case)
    check(figures)
    measured("nearer and farther, any 20 ms", "float64 oracle of its own", figures.local_db, -80.0)


@pytest.mark.parametrize("case", named(near_and_fast()))
def test_near_and_fast(case: Case) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClsimWarning)
        figures = figures_of(case)
    told = [str(w.message) for w in caught if "dB" in str(w.message) and " s" in str(w.message)]
    assert figures.error_db <= PROMISED_DB or told


@pytest.mark.parametrize("case", few(named(fast_ends()), kept=(0, 7, 14)))
def test_fast_ends(case: Case) -> None:
    check(figures_of(replace(case, samples=640)))


@pytest.mark.parametrize("speed", [200.0, 300.0])
def test_what_doppler_takes_out_of_the_band_is_refused(speed: float) -> None:
    case = fast_ends()[4]
    towards = Line((2.0, 2.5, 1.2), (speed, 0.0, 0.0))
    tone = clsim.Signal.tone(19e3, 0.01, 48e3, fade=0.004)
    case = replace(case, signals=(tone,), sources=(towards,), receivers=(Line((11.0, 2.0, 1.2), (-20.0, 0.0, 0.0)),))
    with pytest.raises(InputError, match="Doppler"):
        pressures(replace(case, duration=0.025).plan())


@pytest.mark.parametrize("filters", [clsim.Bandlimited(), clsim.Lagrange(12)])
def test_what_lies_above_the_band_is_refused_and_not_rendered_as_nothing(filters: clsim.Bandlimited | clsim.Lagrange):
    tone = clsim.Signal.tone(0.99 * 24e3, 0.02, 48e3)
    scene = clsim.Scene(
        clsim.Shoebox((6, 5, 4), clsim.Material.from_reflection(0.9)), clsim.Air(),
        [clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 2.0, 2.0)))],
        [clsim.Receiver("r", clsim.Trajectory.line((4.0, 2.0, 2.0), (4.1, 2.0, 2.0), 0.1))],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"half of its energy lies at 237\d\d Hz and above: sample faster"):
        clsim.render(clsim.find_paths(scene, 0), 48e3, interpolator=filters)


@pytest.mark.parametrize("case", few(named(drawn()), kept=range(0, 100, 10)))
def test_drawn_scenes(case: Case, measured) -> None:
    found = figures_of(case).error_db
    measured("drawn scenes with real factors", "float64 oracle of its own", found, PROMISED_DB)


@pytest.mark.parametrize("change", [lambda p: 0.0 * p, lambda p: -p, lambda p: np.roll(p, 1, axis=1)])
def test_wrong_renderings_fail(change) -> None:
    faded = clsim.Signal.tone(40e3, 0.02, 192e3, fade=0.004)
    case = replace(abrupt_tones()[2], signals=(faded,), duration=0.04, samples=640)
    case = replace(case, room=replace(case.room, order=0))
    check(figures_of(case))
    with pytest.raises(AssertionError):
        check(figures_of(case, change))


@pytest.mark.parametrize(("speed", "convolved"), [(0.0, False), (0.0, True), (8.0, False)])
def test_before_the_first_arrival(speed: float, convolved: bool) -> None:
    rate, room = 192e3, Room((6.0, 5.0, 4.0), 0.9, 1, C)
    tone = clsim.Signal.tone(40e3, 0.01, rate)
    case = Case(
        "silence", room, (tone,), (Line((1.0, 2.0, 2.0), (speed, 0.0, 0.0)),), (Line((5.0, 2.0, 2.0)),), rate, 0.03,
        options={"convolve_static": convolved},
    )  # fmt: skip
    plan = case.plan()
    made = pressures(plan)[0]
    arrival = int(4.0 / C * rate)
    at = np.arange(arrival - 1500, arrival + 700)
    exact = case.truth(0, at, band_limits(plan)).pressure
    wrong = np.abs(made[at] - exact)
    assert wrong[: arrival - at[0]].max() <= 10 ** (-80 / 20) * np.abs(exact).max()


def test_the_oracle_by_closed_forms() -> None:
    rate, f, room = 192e3, 40e3, Room((6.0, 5.0, 4.0), 0.9, 2, C)
    tone = clsim.Signal.tone(f, 0.08, rate, fade=0.01)
    here, there = Line((1.0, 2.0, 1.5)), Line((4.0, 3.0, 2.2))
    times = np.arange(round(0.064 * rate), round(0.07 * rate), 7) / rate  # when all paths are steady
    exact = np.zeros(len(times))
    for order, sign, offset in room.images():
        d = float(np.linalg.norm(np.array(there.origin) - sign * np.array(here.origin) - offset))
        loss = 10 ** (-float(room.absorption(np.array(f))) * (d - 1.0) / 20)
        exact += 0.9**order / d * loss * np.sin(2 * np.pi * f * (times - d / C))
    made = oracle.truth([(Emitted(tone.read(0, tone.count), rate, 0.0, room), here)], there, room, times)
    assert oracle.error_db(made.pressure, exact) < -120.0
    # Two ends on a line at Mach 0.5: c delay = 10 - v t - v (t - delay).
    near = oracle.delays(Line((0, 0, 0), (C / 2, 0, 0)), Line((10, 0, 0), (-C / 2, 0, 0)), np.ones(3), np.zeros(3), times[:9] / 10, C)  # fmt: skip
    np.testing.assert_allclose(near[0], (10.0 / C - times[:9] / 10) / 0.5, rtol=1e-12)
    np.testing.assert_allclose(near[1], 0.5, rtol=1e-12)


def test_a_finer_oracle_says_the_same() -> None:
    rate, room = 192e3, Room((6.0, 5.0, 4.0), 0.9, 2, C)
    tone = clsim.Signal.tone(76e3, 0.02, rate)
    ways = Line((1.0, 2.0, 1.5), (8.0, 3.0, 2.0)), Line((4.0, 3.0, 2.2), (-7.0, 4.0, 1.0))
    times = np.sort(np.random.default_rng(1).choice(int(0.05 * rate), 300, replace=False)) / rate
    taps = firwin(101, 86e3, fs=rate)
    coarse, fine = (
        oracle.truth([(Emitted(tone.read(0, tone.count), rate, 0.0, room, taps, f), ways[0])], ways[1], room, times)
        for f in (Fineness(), Fineness(8, 18, 12, 16_384))
    )
    assert oracle.error_db(coarse.pressure, fine.pressure) < -120.0
