"""Tests that prove that they can fail: what they render is taken once, and played to them again with something wrong."""

import copy
import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest

import clsim
from clsim.recording import Recording
from clsim.render.opencl.engine import OpenclEngine

MUTANTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "silent": lambda samples: 0.0 * samples,
    "upside down": lambda samples: -samples,
    "a sample late": lambda samples: np.concatenate([np.zeros_like(samples[:, :1]), samples[:, :-1]], axis=1),
}


def proven(test: Callable[..., None]) -> Callable[..., None]:
    """Run a test; then again with each mutant of the sound that its engine rendered, and demand that it fails.

    What is taken from the OpenCL engine must be what the kernels gave: nothing is convolved beside them.
    """

    @functools.wraps(test)
    def run(**arguments: Any) -> None:
        engine, before = arguments.get("engine", "opencl"), copy.deepcopy(arguments)
        # Figures of mutants are none of clsim's.
        unnoted = {name: _bounded for name in arguments if name == "measured"}
        takes: list[tuple[Recording, bool]] = []
        with _each(lambda render: _taking(render, engine, takes)):
            test(**arguments)
        assert any(mutable for _, mutable in takes)
        for name, wrong in MUTANTS.items():
            played = iter(_mutated(takes, wrong))
            with _each(lambda render, played=played: lambda *_, **__: next(played)):
                try:
                    test(**copy.deepcopy(before) | unnoted)
                except (AssertionError, RuntimeWarning):  # a warning is an error here: silence divided by silence
                    continue
            pytest.fail(f"passes where the sound is {name}")

    return run


def _bounded(claim: str, oracle: str, value: float, allowed: float, *_: str) -> float:
    """Demand that a figure is within what is allowed, without a note."""
    assert value <= allowed, (claim, oracle)
    return value


def _each(wrap: Callable[[Any], Any]) -> Any:
    """Replace both ways to render."""
    return mock.patch.multiple(clsim, render=wrap(clsim.render), render_tracks=wrap(clsim.render_tracks))


def _taking(render: Any, engine: str, takes: list[tuple[Recording, bool]]) -> Callable[..., Recording]:
    """Return a renderer that keeps its results."""
    original = OpenclEngine.add

    def taken(*arguments: Any, **options: Any) -> Recording:
        pieces: list[np.ndarray] = []

        def kept(self: OpenclEngine, pressure: np.ndarray, start: int) -> None:
            pieces.append(np.zeros_like(pressure))
            original(self, pieces[-1], start)
            pressure += pieces[-1]

        with mock.patch.object(OpenclEngine, "add", kept):
            made = render(*arguments, **options)
        used = options.get("engine", "opencl")
        if used == "opencl":
            assert pieces, "no kernel made this sound"
            np.testing.assert_array_equal(np.concatenate(pieces, axis=1), made.samples)
        takes.append((made, used == engine))
        return made

    return taken


def _mutated(takes: list[tuple[Recording, bool]], wrong: Callable[[np.ndarray], np.ndarray]) -> Iterator[Recording]:
    for made, mutable in takes:
        yield dataclasses.replace(made, samples=wrong(made.samples)) if mutable else made
