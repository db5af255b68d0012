"""Render options: one place for types, defaults, bounds and words; every function that takes them agrees."""

import inspect
from dataclasses import fields

import numpy as np
import pytest

import clsim
from clsim.render.options import RenderOptions

OPTIONS = fields(RenderOptions)


def scene() -> clsim.Scene:
    tone = clsim.Signal.tone(1e3, 0.01, 16e3, fade=2e-3)
    source = clsim.Source("s", tone, clsim.Trajectory.line((1, 1, 1), (1.01, 1, 1), 0.1))
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((2, 2, 2)))
    return clsim.Scene(clsim.Shoebox((4, 3, 3), clsim.Material.from_reflection(0.9)), clsim.Air(), [source], [receiver])


@pytest.mark.parametrize("function", [clsim.render, clsim.plan_render])
def test_signature_and_docstring_list_every_option(function) -> None:
    parameters = inspect.signature(function).parameters
    assert list(parameters) == ["paths", *(f.name for f in OPTIONS)]
    own = inspect.cleandoc(RenderOptions.__doc__)
    for f in OPTIONS:
        assert parameters[f.name].default == inspect.signature(RenderOptions).parameters[f.name].default
        told = own[own.index(f"\n{f.name} : ") :].split("\n")[1:3]
        assert "\n".join(told) in function.__doc__
    assert "options : RenderOptions" not in function.__doc__
    assert "Returns\n-------" in function.__doc__


def test_all_are_checked_and_converted_once() -> None:
    made = RenderOptions(np.float32(16e3), transition=0, baseband=[2e3, 500.0], chunk=np.int64(5))
    assert type(made.sampling_rate) is float
    assert type(made.transition) is float
    assert made.baseband == clsim.Baseband(2e3, 500.0, 640.0)
    assert type(made.chunk) is int
    assert RenderOptions(**{f.name: getattr(made, f.name) for f in OPTIONS}) == made
    with pytest.raises(AttributeError):
        made.chunk = 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sampling_rate": 10.0}, "sampling_rate: must be at least 1000 Hz, but is 10 Hz"),
        ({"interpolator": "linear"}, "interpolator: must be an interpolator, but is 'linear'"),
        ({"motion": "still"}, 'motion: must be one of "retarded", "quasi-static", but is \'still\''),
        ({"amplitude": 1}, 'amplitude: must be one of "wave-equation", "static", "convective", but is 1'),
        ({"transition": "gate"}, "transition: must be a number, but is 'gate'"),
        ({"transition": -1e-3}, "transition: must be at least 0 s, but is -0.001 s"),
        ({"responses": "middle"}, 'responses: must be one of "band", "centre", but is \'middle\''),
        ({"response_error_db": "centre"}, "response_error_db: must be a number, but is 'centre'"),
        ({"response_error_db": -10.0}, "response_error_db: must be at most -20 dB, but is -10 dB"),
        ({"baseband": 4e3}, "baseband: must be a carrier and a bandwidth, Hz, but is 4000.0"),
        ({"baseband": (4e3, 1e3), "interpolator": clsim.Lagrange(3)}, "interpolator: must be Bandlimited in baseband"),
        ({"prune_below_db": 3.0}, "prune_below_db: must be at most -20 dB, but is 3 dB"),
        ({"scattering_error_db": -20.0}, "scattering_error_db: must be at most -40 dB, but is -20 dB"),
        ({"engine": "gpu"}, 'engine: must be one of "opencl", "reference", but is \'gpu\''),
        ({"device": 0}, "device: must be an id or part of a name, but is 0"),
        ({"duration": 0.0}, "duration: must be above 0 s, but is 0 s"),
        ({"chunk": 0}, "chunk: must be at least 1, but is 0"),
        ({"convolve_static": 1}, "convolve_static: must be True or False, but is 1"),
        ({"channels": "yes"}, "channels: must be True or False, but is 'yes'"),
        ({"narrowband": "yes"}, "narrowband: must be True or False, but is 'yes'"),
        ({"tail": "on"}, 'tail: must be one of "off", "auto", but is \'on\''),
        ({"tail": "auto", "baseband": (4e3, 1e3)}, "tail: must be 'off' in baseband, but is 'auto'"),
        ({"tail_directions": 4}, "tail_directions: must be from 16 to 1024, but is 4"),
        ({"tail_error_db": 0.0}, "tail_error_db: must be at least 0.02 dB, but is 0 dB"),
        ({"tail_scattering": "all"}, 'tail_scattering: must be one of "size", "material", but is \'all\''),
        ({"tail_seed": -1}, "tail_seed: must be at least 0, but is -1"),
        ({"narrowband": True, "baseband": (4e3, 1e3)}, "narrowband: must not be True in baseband"),
    ],
)
def test_errors_name_option_rule_and_value(wrong: dict, message: str) -> None:
    paths = clsim.find_paths(scene(), 0)
    with pytest.raises(clsim.InputError) as error:
        clsim.plan_render(paths, **({"sampling_rate": 16e3} | wrong))
    assert str(error.value).startswith(message)


def test_every_option_has_a_wrong_value_above() -> None:
    mark = test_errors_name_option_rule_and_value.pytestmark[0]
    assert {name for wrong, _ in mark.args[1] for name in wrong} == {f.name for f in OPTIONS}


def test_tracks_have_some_options_already() -> None:
    paths = clsim.find_paths(scene(), 0)
    tracks = clsim.track(paths, motion="quasi-static")
    signals = [scene().sources[0].signal]
    made = clsim.render_tracks(signals, tracks, 16e3, engine="reference", duration=0.01)
    assert made.samples.shape == (1, 160)
    for f in OPTIONS:
        if f.metadata.get("of_tracks"):
            with pytest.raises(clsim.InputError, match=f"^{f.name}: must be left out, for the tracks have it already"):
                clsim.render_tracks(signals, tracks, 16e3, **{f.name: f.default})
    with pytest.raises(TypeError, match="unexpected keyword argument 'sped'"):
        clsim.render_tracks(signals, tracks, 16e3, sped=1)
    with pytest.raises(clsim.InputError, match=r"starts: must be one per signal, 1, but are 2"):
        clsim.render_tracks(signals, tracks, 16e3, starts=[0.0, 1.0])
    with pytest.raises(clsim.InputError, match=r"signals: must be a list, but is Signal\("):
        clsim.render_tracks(signals[0], tracks, 16e3)


def test_a_call_that_is_wrong_is_told_in_its_own_words() -> None:
    paths = clsim.find_paths(scene(), 0)
    for function in (clsim.render, clsim.plan_render):
        with pytest.raises(
            TypeError, match=rf"^{function.__name__}\(\) got an unexpected keyword argument 'tranition'"
        ):
            function(paths, 16e3, tranition=0)
        with pytest.raises(TypeError, match=rf"^{function.__name__}\(\) missing a required argument: 'sampling_rate'"):
            function(paths)
