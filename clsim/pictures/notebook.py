"""Notebook output: tables as HTML, pages inline, sound."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

from clsim.packages import check_packages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


def html_table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]], notes: Sequence[str] = ()) -> str:
    """Return a table as HTML, with a title above it and lines below."""

    def row(cells: Sequence[object], kind: str) -> str:
        """Return a row of a table, of cells of a kind (``th`` or ``td``)."""
        return "<tr>" + "".join(f"<{kind}>{html.escape(str(cell))}</{kind}>" for cell in cells) + "</tr>"

    body = row(head, "th") + "".join(row(cells, "td") for cells in rows)
    below = "".join(f"<div>{html.escape(note)}</div>" for note in notes)
    return f"<div><b>{html.escape(title)}</b><table>{body}</table>{below}</div>"


def inline_page(field: str, page: str, height: int) -> Any:
    """Return an HTML page for display in a notebook, of a height in pixels; errors name `field`."""
    check_packages(field, "a notebook", "notebook", "IPython")
    from IPython import display

    shown: Any = display.HTML  # its types are not told
    return shown(
        f'<div><iframe srcdoc="{html.escape(page)}" width="100%" height="{height}" style="border: 0"></iframe></div>'
    )


def inline_sound(field: str, samples: NDArray[Any], rate: int) -> Any:
    """Return a player of samples (n,) for a notebook at a rate, Hz; errors name `field`."""
    check_packages(field, "a notebook", "notebook", "IPython")
    from IPython import display

    played: Any = display.Audio  # its types are not told
    return played(data=samples, rate=rate)
