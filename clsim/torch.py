"""Renders as functions of PyTorch tensors, for losses of what is received."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.packages import check_packages
from clsim.render.options import RenderOptions
from clsim.sensitivity.linear_map import plan_of, received
from clsim.sensitivity.sensitivities import gradient

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from clsim.paths.path_set import PathSet

    MakePaths = Callable[[dict[str, NDArray[Any]]], PathSet]

__all__ = ["render"]


def render(make_paths: MakePaths, tensors: Mapping[str, Any], sampling_rate: float, **options: Any) -> Any:
    """Render the sound at every receiver as a differentiable function of tensors.

    Parameters
    ----------
    make_paths : callable
        Takes the values of the tensors by name, as NumPy arrays; returns the paths of the scene that they make.
    tensors : mapping of str to torch.Tensor
        By the name of the parameter that each is, as of `clsim.gradient`, in its unit: ``receivers[0].position`` (3,).
    sampling_rate : float
        Of the signals, Hz.
    **options
        As of `clsim.gradient`, with a duration.

    Returns
    -------
    torch.Tensor (receivers, samples)
        On the host, of the tensors' type; without noise and rounding of converters.

    Raises
    ------
    InputError
        If torch is missing, an argument breaks a rule, or a parameter has no derivative.

    Notes
    -----
    Forward and backward are by the same engine; the gradient is that of `clsim.gradient`: paths that begin or end as a
    parameter changes are not seen by it.
    """
    check_packages("render", "a render of tensors", "torch", "torch")
    if not tensors:
        raise InputError("tensors", "must hold at least one, but is empty")
    if options.get("duration") is None:
        raise InputError("duration", "must be given, so that the shape of the result does not change")
    rendered: Any = _function().apply(make_paths, tuple(tensors), sampling_rate, options, *tensors.values())
    return rendered


@cache
def _function() -> Any:
    """Return the `torch.autograd.Function` of a render."""
    import torch

    ways = {"forward": staticmethod(_forward), "backward": staticmethod(_backward)}
    return type("Render", (torch.autograd.Function,), ways)


def _forward(
    ctx: Any, make: MakePaths, names: tuple[str, ...], rate: float, options: dict[str, Any], *tensors: Any
) -> Any:
    """Render the scene that the tensors make."""
    import torch

    ctx.paths = make({n: t.detach().cpu().numpy() for n, t in zip(names, tensors, strict=True)})
    ctx.names, ctx.rate, ctx.options = names, rate, options
    ctx.like = [(t.shape, t.dtype, t.device) for t in tensors]
    rows = received(plan_of(ctx.paths, RenderOptions(rate, **options)))
    return torch.from_numpy(rows).to(tensors[0].dtype)


def _backward(ctx: Any, weights: Any) -> Any:
    """Return the derivatives of the loss by all tensors."""
    import torch

    wanted = [name for name, needed in zip(ctx.names, ctx.needs_input_grad[4:], strict=True) if needed]
    found = gradient(ctx.paths, weights.cpu().double().numpy(), wanted, ctx.rate, **ctx.options)
    given = [
        torch.from_numpy(np.array(found[name], dtype=np.float64)).reshape(shape).to(dtype).to(device)
        if name in found else None
        for name, (shape, dtype, device) in zip(ctx.names, ctx.like, strict=True)
    ]  # fmt: skip
    return (None, None, None, None, *given)
