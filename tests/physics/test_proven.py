"""What proves tests finds those that cannot fail."""

import numpy as np
import pytest
from proven import MUTANTS, proven

import clsim

pytestmark = pytest.mark.usefixtures("device")


def sound(at_rest: bool) -> np.ndarray:
    source = clsim.Source("s", clsim.Signal.tone(40e3, 0.01, 192e3, fade=0.002), clsim.Trajectory.fixed((1, 1, 1)))
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((2, 2, 1)))
    room = clsim.Shoebox((4, 3, 2.5), clsim.Material.from_reflection(0.9))
    scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
    paths = clsim.find_paths(scene, 0)
    return clsim.render(paths, 192e3, duration=0.01, convolve_static=at_rest).pressure[0]


def looks_for(name: str, engine: str) -> None:
    """Pass unless the sound is as one of the mutants makes it; all others go unseen."""
    heard = sound(at_rest=False)
    right = RIGHT.setdefault(engine, heard)
    assert not np.array_equal(heard, MUTANTS[name](right[None])[0])


RIGHT: dict[str, np.ndarray] = {}


@pytest.mark.parametrize(("seen", "unseen"), [("silent", "upside down"), ("upside down", "silent")])
def test_a_test_that_misses_a_mutant_fails(seen: str, unseen: str) -> None:
    @proven
    def one_sided(engine: str) -> None:
        looks_for(seen, engine)

    with pytest.raises(pytest.fail.Exception, match=f"passes where the sound is {unseen}"):
        one_sided(engine="opencl")


def test_a_test_that_sees_all_passes() -> None:
    @proven
    def good(engine: str) -> None:
        for name in MUTANTS:
            looks_for(name, engine)

    good(engine="opencl")


def test_ends_at_rest_that_are_convolved_prove_nothing() -> None:
    @proven
    def convolved(engine: str) -> None:
        assert np.any(sound(at_rest=True))

    with pytest.raises(AssertionError, match="no kernel"):
        convolved(engine="opencl")
