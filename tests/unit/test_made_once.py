"""What tests share within a run."""

from typing import Any

import pytest


def never() -> Any:
    raise AssertionError("made again")


@pytest.mark.parametrize("turn", [0, 1])
def test_what_was_made_is_not_made_again(turn: int, once) -> None:
    name = f"a list of {turn}"
    assert once(name, lambda: [turn]) == once(name, never) == [turn]
    with pytest.raises(AssertionError, match="made again"):
        once(f"{name}, not made yet", never)
