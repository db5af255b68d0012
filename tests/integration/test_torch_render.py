"""Renders of tensors: their gradients against differences, and a descent."""

from typing import Any

import numpy as np
import pytest

import clsim

torch = pytest.importorskip("torch", reason="torch is not installed")

RATE = 48e3
PULSE = clsim.Signal.chirp(6e3, 12e3, 0.003, sampling_rate=RATE, fade=0.001)
START = {"receivers[0].position": [2.0, 1.5, 1.2], "air.temperature_celsius": 20.0}
OPTIONS: dict[str, Any] = {"engine": "reference", "duration": 0.014, "response_error_db": -120.0}


def made(values: dict[str, Any]) -> Any:
    """Return the paths of a small room with a receiver at a place, in air of a temperature."""
    signal = values.get("sources[0].signal")
    scene = clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.7)),
        clsim.Air(temperature_celsius=float(values.get("air.temperature_celsius", 20.0))),
        [clsim.Source("s", PULSE if signal is None else clsim.Signal.from_array(signal, RATE),
                      clsim.Trajectory.line((1.0, 1.0, 1.0), (1.2, 1.1, 1.0), 0.1))],
        [clsim.Receiver("r", clsim.Trajectory.fixed(values.get("receivers[0].position", START["receivers[0].position"])))],
    )  # fmt: skip
    return clsim.find_paths(scene, 1)


def loss(*tensors: Any) -> Any:
    """Return a number that depends on the phases of what is received."""
    rows = clsim.torch.render(made, dict(zip(START, tensors, strict=True)), RATE, **OPTIONS)
    return torch.sum(rows * torch.linspace(-1.0, 2.0, rows.shape[1], dtype=rows.dtype)) + torch.sum(rows**2)


def test_gradients_are_those_of_differences() -> None:
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in START.values()]
    assert torch.autograd.gradcheck(loss, tensors, eps=1e-6, rtol=1e-3, atol=1e-4)


def test_gradients_by_what_is_emitted() -> None:
    signal = torch.tensor(PULSE.read(0, PULSE.count), requires_grad=True)
    rows = clsim.torch.render(made, {"sources[0].signal": signal}, RATE, **OPTIONS)
    energy = torch.sum(rows**2)
    energy.backward()
    assert float(signal.grad @ signal.detach()) == pytest.approx(2.0 * float(energy.detach()), rel=1e-3)


def test_a_descent_finds_the_receiver() -> None:
    """Gauss-Newton is for others: plain gradients of a low band suffice from 2 mm off."""
    truth = torch.tensor(START["receivers[0].position"], dtype=torch.float64)
    wanted = clsim.torch.render(made, {"receivers[0].position": truth}, RATE, **OPTIONS).detach()
    place = (truth + torch.tensor([0.002, -0.001, 0.001])).requires_grad_()
    optimiser = torch.optim.LBFGS([place], max_iter=12, line_search_fn="strong_wolfe")

    def closure() -> Any:
        optimiser.zero_grad()
        rows = clsim.torch.render(made, {"receivers[0].position": place}, RATE, **OPTIONS)
        wrong = torch.sum((rows - wanted) ** 2) / torch.sum(wanted**2)
        wrong.backward()
        return wrong

    optimiser.step(closure)
    assert np.linalg.norm((place.detach() - truth).numpy()) < 1e-4


def test_the_shape_of_the_result_is_given() -> None:
    with pytest.raises(clsim.InputError, match="duration: must be given"):
        clsim.torch.render(made, {"receivers[0].position": torch.zeros(3)}, RATE)
    with pytest.raises(clsim.InputError, match="tensors: must hold at least one"):
        clsim.torch.render(made, {}, RATE, **OPTIONS)
    with pytest.raises(clsim.InputError, match="baseband: must be left out"):
        clsim.torch.render(made, {"receivers[0].position": torch.zeros(3)}, RATE, **OPTIONS, baseband=(9e3, 4e3))


def of_place(place: Any, **more: Any) -> Any:
    """Render with a receiver at a place, or another value by name."""
    return clsim.torch.render(made, {"receivers[0].position": place, **more}, RATE, **OPTIONS)


PLACE = torch.tensor(START["receivers[0].position"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: of_place(torch.tensor([2, 1, 1])),
            "tensors['receivers[0].position']: must be a tensor of real floating-point numbers, but is torch.int64",
        ),
        (
            lambda: of_place(np.ones(3)),
            "tensors['receivers[0].position']: must be a tensor of real floating-point numbers, but is ndarray",
        ),
        (
            lambda: clsim.torch.render(lambda _: None, {"receivers[0].position": PLACE}, RATE, **OPTIONS),
            "make_paths: must return a PathSet, but returns None",
        ),
        (
            lambda: of_place(PLACE, **{"receivers[0].positio": PLACE}),
            "wrt: must name parameters that have a derivative, but has 'receivers[0].positio'",
        ),
        (
            lambda: of_place(PLACE, **{"sources[0].gain_db": PLACE}),
            "tensors['sources[0].gain_db']: must hold 1 number, but holds 3",
        ),
        (
            lambda: of_place(PLACE.clone().requires_grad_()).sum().backward(create_graph=True),
            "create_graph: must be False: a render of tensors has first derivatives alone, but is True",
        ),
    ],
)
def test_errors_name_field_rule_and_value(call: Any, message: str) -> None:
    with pytest.raises(clsim.InputError) as error:
        call()
    assert str(error.value) == message
