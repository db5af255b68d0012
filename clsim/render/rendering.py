"""Execution of a plan: the sum of contributions to the pressure, then the receivers' electronics."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.device import find_device
from clsim.render.receiver_chain import ReceiverChain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from clsim.render.contributions import State
    from clsim.render.plan import Plan


class PressureSum:
    """Sum of a plan's contributions, chunk by chunk."""

    def __init__(self, plan: Plan) -> None:
        if plan.options.engine == "opencl":
            find_device(plan.options.device)
        self._plan = plan
        self._adding = tuple(contribution.begin() for contribution in plan.contributions)

    def __call__(self, start: int) -> NDArray[Any]:
        """Return the pressure (rows, n) of the chunk that begins with sample `start`, Pa."""
        plan = self._plan
        stop = min(start + plan.chunk, plan.samples)
        pressure = np.zeros((plan.row_count, stop - start), plan.pressure_type)
        for adding in self._adding:
            adding.add(pressure, start)
        return pressure

    def until(self, last: int) -> None:
        """Hint: chunks from sample `last` on will not be requested yet."""
        for adding in self._adding:
            adding.until(last)

    def shared(self, first: int, last: int) -> list[str]:
        """Return the names of arrays that samples `first` to `last` share with others."""
        return [f"{i}.{name}" for i, adding in enumerate(self._adding) for name in adding.shared(first, last)]

    def made(self, name: str) -> NDArray[Any]:
        """Compute the shared array of a name, of any shape."""
        number, _, rest = name.partition(".")
        return self._adding[int(number)].made(rest)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Get shared arrays from `find`, by name, instead of computing them."""

        def found(number: int, name: str) -> NDArray[Any]:
            return find(f"{number}.{name}")

        for i, adding in enumerate(self._adding):
            adding.look_up(partial(found, i))

    def state(self) -> State:
        """Return the state after the chunks so far; empty if chunks are independent."""
        parts: State = {}
        for i, adding in enumerate(self._adding):
            parts |= {f"contribution{i}.{name}": value for name, value in adding.state().items()}
        return parts

    def restore(self, state: State) -> None:
        """Continue from the `state` of another object of the same plan; its arrays have any shape."""
        for i, adding in enumerate(self._adding):
            mine = f"contribution{i}."
            adding.restore({name.removeprefix(mine): state[name] for name in state if name.startswith(mine)})

    def warn(self) -> None:
        """Warn of results that miss the requested accuracy."""
        for adding in self._adding:
            adding.warn()


class Rendering:
    """A plan's contributions and receivers, with all that they remember of what is rendered.

    Parameters
    ----------
    plan : Plan
        From `plan_render`.

    Raises
    ------
    DeviceError
        If the plan's device is missing, even where nothing needs it.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._pressure = PressureSum(plan)
        self._receivers = ReceiverChain(plan)

    @property
    def clipped(self) -> tuple[int, ...]:
        """Samples at each receiver that its converter clipped so far."""
        return self._receivers.clipped

    def pieces(self, first: int = 0) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield the recording chunk by chunk; see `render_chunks`.

        Parameters
        ----------
        first : int
            Sample to begin with, the first one of a chunk.

        Yields
        ------
        start : int
            First sample of the piece.
        samples : ndarray (receivers, n)
            Pa or V.
        """
        for start in range(first, self._plan.samples, self._plan.chunk):
            yield start, self._receivers(start, self._pressure(start))
        self._pressure.warn()
        self._receivers.warn()

    def state(self) -> State:
        """Return all that is remembered of the pieces so far: what another process needs to go on bit for bit."""
        return self._pressure.state() | self._receivers.state()

    def restore(self, state: State) -> None:
        """Go on where another one of the same plan was.

        Parameters
        ----------
        state : dict of ndarray, of any shape
            What that one's `state` returned.
        """
        self._pressure.restore(state)
        self._receivers.restore(state)

    def describe(self) -> list[str]:
        """Describe the result, one line for each fact."""
        return self._receivers.describe()
