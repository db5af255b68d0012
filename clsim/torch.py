"""PyTorch: members of a study with shards as a data set, and renders as functions of tensors."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_choice, as_count, as_flag
from clsim.errors import InputError, check_packages, counted
from clsim.paths.path_set import PathSet
from clsim.sensitivity.linear_map import plan_of, received
from clsim.sensitivity.sensitivities import gradient, named, options_of
from clsim.study.file import SOUNDS
from clsim.study.shards import member_count, members_of, sounds_of, tables_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from os import PathLike
    from pathlib import Path

    from numpy.typing import NDArray

    MakePaths = Callable[[dict[str, NDArray[Any]]], PathSet]
    _Base = object
else:
    try:
        from torch.utils.data import IterableDataset as _Base
    except ImportError:  # who makes a data set is told
        _Base = object


__all__ = ["Members", "render"]


class Members(_Base):
    """Members of a study that was written as shards, for ``torch.utils.data.DataLoader``.

    Parameters
    ----------
    folder : path-like
        Output folder of ``clsim study``.
    sounds : sequence of str
        Sounds of each member, by their words in the study's `keep`: ``"recording"``, ``"direct"``, ``"reverberant"``,
        ``"noise"``.
    labels : sequence of str
        Columns of the shards' tables.
    shuffle : bool
        Whether shards, and members within each, come in another order in each epoch; see `set_epoch`.
    seed : int
        Seed of these orders.

    Raises
    ------
    InputError
        If an argument breaks a rule, the folder holds no shards, a package is missing, or, as members are read, a shard
        is not what was written.

    Notes
    -----
    Each member is a dictionary: ``key``, tensors (rows, samples) float32 of the sounds by name, and labels: numbers as
    tensors, NaN where there is none, and texts. Workers of a loader read shards of their own, so that each member
    comes once; there should be as many shards as workers, or more. Workers may be forked or spawned.

    Examples
    --------
    >>> import clsim.torch
    >>> clsim.torch.Members("nowhere")
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: folder: must hold shards of a study, but 'nowhere' holds none
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        sounds: Sequence[str] = ("recording",),
        labels: Sequence[str] = (),
        *,
        shuffle: bool = False,
        seed: int = 0,
    ) -> None:
        self._tables = tables_of(folder)
        check_packages("folder", "a data set", "torch", "torch")
        self._sounds = tuple(as_choice(f"sounds[{i}]", name, tuple(sorted(SOUNDS))) for i, name in enumerate(sounds))
        self._labels, self._shuffle = tuple(labels), as_flag("shuffle", shuffle)
        self._seed, self._epoch = as_count("seed", seed), 0

    def __len__(self) -> int:
        return sum(map(member_count, self._tables))

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of members by the number of the `epoch`, from 0, before a loader's workers start."""
        self._epoch = as_count("epoch", epoch)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        from torch.utils.data import get_worker_info

        chance = np.random.default_rng([self._seed, self._epoch])
        tables = [self._tables[i] for i in chance.permutation(len(self._tables))] if self._shuffle else self._tables
        worker = get_worker_info()
        for table in tables if worker is None else tables[worker.id :: worker.num_workers]:
            yield from self._members_of(table)

    def _members_of(self, table: Path) -> Iterator[dict[str, Any]]:
        """Yield the members of a shard, those of a shuffled one in an order of its own."""
        members = members_of(table)
        if self._shuffle:
            held = list(members)
            seeds = [self._seed, self._epoch, int(table.stem.rpartition("-")[2])]
            members = (held[i] for i in np.random.default_rng(seeds).permutation(len(held)))
        for labels, files in members:
            yield self._tensors(labels, files)

    def _tensors(self, labels: dict[str, Any], files: dict[str, bytes]) -> dict[str, Any]:
        import torch

        found: dict[str, Any] = {"key": labels["key"]}
        for name, samples in sounds_of(labels, files, self._sounds).items():
            found[name] = torch.from_numpy(np.ascontiguousarray(samples))
        for name in self._labels:
            if name not in labels:
                raise InputError("labels", f"must be columns of the shards, but {labels['key']} has no {name!r}")
            found[name] = _tensor(labels[name])
        return found


def _tensor(value: Any) -> Any:
    """Return nested lists of numbers as a tensor; texts stay, of digits too."""
    import torch

    first = value
    while isinstance(first, list) and first:
        first = first[0]
    if isinstance(first, str | dict):
        return value
    return torch.from_numpy(np.array(value, dtype=bool if isinstance(first, bool) else np.float64))


def render(make_paths: MakePaths, tensors: Mapping[str, Any], sampling_rate: float, **options: Any) -> Any:
    """Render the sound at every receiver as a differentiable function of tensors.

    Parameters
    ----------
    make_paths : callable
        Takes the values of the tensors by name, as NumPy arrays; returns the paths of the scene that they make.
    tensors : mapping of str to torch.Tensor
        By the name of the parameter that each is, as of `clsim.gradient`, in its unit: ``receivers[0].position`` (3,).
    sampling_rate : float
        Sampling rate of the signals, Hz.
    **options
        As of `clsim.gradient`, with a duration, but for baseband.

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
    import torch

    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point():
            given = tensor.dtype if isinstance(tensor, torch.Tensor) else type(tensor).__name__
            raise InputError(f"tensors[{name!r}]", f"must be a tensor of real floating-point numbers, but is {given}")
    if options.get("duration") is None:
        raise InputError("duration", "must be given, so that the shape of the result does not change")
    if options.get("baseband") is not None:
        raise InputError("baseband", "must be left out of renders of tensors, which are real")
    rendered: Any = _function().apply(make_paths, tuple(tensors), sampling_rate, options, *tensors.values())
    return rendered


@cache
def _function() -> Any:
    """Return the `torch.autograd.Function` of a render."""
    import torch

    methods = {"forward": staticmethod(_forward), "backward": staticmethod(_backward)}
    return type("Render", (torch.autograd.Function,), methods)


def _forward(
    ctx: Any, make: MakePaths, names: tuple[str, ...], rate: float, options: dict[str, Any], *tensors: Any
) -> Any:
    """Render the scene that the tensors make."""
    import torch

    ctx.paths, settings = (
        make({n: t.detach().cpu().numpy() for n, t in zip(names, tensors, strict=True)}),
        options_of(rate, options),
    )
    if not isinstance(ctx.paths, PathSet):
        raise InputError("make_paths", f"must return a PathSet, but returns {ctx.paths!r:.80}")
    for name, parameters in named(ctx.paths, names, settings).items():
        count = tensors[names.index(name)].numel()
        if parameters and count != len(parameters):
            raise InputError(f"tensors[{name!r}]", f"must hold {counted(len(parameters), 'number')}, but holds {count}")
    ctx.names, ctx.rate, ctx.options = names, rate, options
    ctx.like = [(t.shape, t.dtype, t.device) for t in tensors]
    rows = received(plan_of(ctx.paths, settings, by_functions=False))
    return torch.from_numpy(rows).to(tensors[0].dtype)


def _backward(ctx: Any, weights: Any) -> Any:
    """Return the derivatives of the loss by all tensors."""
    import torch

    if torch.is_grad_enabled():
        raise InputError("create_graph", "must be False: a render of tensors has first derivatives alone, but is True")
    wanted = [name for name, needed in zip(ctx.names, ctx.needs_input_grad[4:], strict=True) if needed]
    found = gradient(ctx.paths, weights.cpu().double().numpy(), wanted, ctx.rate, **ctx.options)
    given = [
        torch.from_numpy(np.array(found[name], dtype=np.float64)).reshape(shape).to(dtype).to(device)
        if name in found else None
        for name, (shape, dtype, device) in zip(ctx.names, ctx.like, strict=True)
    ]  # fmt: skip
    return (None, None, None, None, *given)
