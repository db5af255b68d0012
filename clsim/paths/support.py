"""The support matrix: which paths are possible in which medium, and whether a device or the host makes their nodes.

Refusals, the choice of device or host, and the table of ``docs/limitations.md`` are made from it.
"""

from __future__ import annotations

from dataclasses import dataclass

from clsim.errors import InputError
from clsim.scene.air import Air

DEVICE, HOST, REFUSED = "device", "host", "refused"
MEDIA = ("still air", "wind", "air by height", "fluctuating air")
# Methods of rendering, and the media in which they take pairs whose paths change with both ends alone.
METHODS = {
    "sum over paths": MEDIA,
    "narrow bands": MEDIA,
    "convolution (pairs at rest)": MEDIA[:3],
    "sampled channels": MEDIA[:3],
}


@dataclass(frozen=True, slots=True)
class Support:
    """Support of chains of one kind of leg and vertex.

    Attributes
    ----------
    paths : str
        The paths, in words.
    where : tuple of str
        In each of `MEDIA`: `DEVICE`, `HOST` or `REFUSED`.
    program : str or None
        Name of the columns of a device's program of nodes.
    refusal : tuple (str, str) or None
        Field and rule of the error where a medium is refused.
    """

    paths: str
    where: tuple[str, str, str, str]
    program: str | None = None
    refusal: tuple[str, str] | None = None


_BODIES = ("bodies", "must be left out where the air depends on the height or fluctuates")
_SCATTERERS = ("scatterers", "must be left out where the air depends on the height or fluctuates")
_TWO_EDGES = ("diffraction", "must be at most 1 where the air depends on the height or fluctuates, but is 2")
_TWO_SCATTERERS = ("scatterers_in_row", "must be 1 where the air moves, depends on the height or fluctuates, but is 2")
_EDGE_AND_SCATTERER = ("edge_scattering", "must be false where the air moves, depends on the height or fluctuates")
_BEHIND_BODIES = HOST, HOST, REFUSED, REFUSED
SUPPORT = {  # by `Chain.kind`
    "static": Support("reflections, straight through panels too", (DEVICE, DEVICE, HOST, HOST), "images"),
    "static edge": Support("one edge", (DEVICE, HOST, HOST, HOST), "edges"),
    "static exact edge": Support('one edge, `diffraction_model="btm"`', (HOST, HOST, HOST, HOST)),
    "static edge pair": Support("two edges of one face", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static edge gap": Support("two edges with air between", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static edge and end": Support("an edge and an end of another", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static scatterer": Support("a scatterer", (DEVICE, DEVICE, REFUSED, REFUSED), "scatterers", _SCATTERERS),
    "static scatterer pair": Support("two scatterers", (HOST, REFUSED, REFUSED, REFUSED), refusal=_TWO_SCATTERERS),
    "static edge scatterer": Support(
        "an edge and a scatterer", (HOST, REFUSED, REFUSED, REFUSED), refusal=_EDGE_AND_SCATTERER
    ),
    "static scatterer edge": Support(
        "a scatterer and an edge", (HOST, REFUSED, REFUSED, REFUSED), refusal=_EDGE_AND_SCATTERER
    ),
    "static edge scatterer edge": Support(
        "an edge, a scatterer and an edge", (HOST, REFUSED, REFUSED, REFUSED), refusal=_EDGE_AND_SCATTERER
    ),
    "moving": Support("bodies", (DEVICE, DEVICE, REFUSED, REFUSED), "bodies", _BODIES),
    "moving edge": Support("bodies and an edge", _BEHIND_BODIES, refusal=_BODIES),
    "moving exact edge": Support('bodies and an edge, `diffraction_model="btm"`', _BEHIND_BODIES, refusal=_BODIES),
    "moving edge pair": Support("bodies and two edges of one face", _BEHIND_BODIES, refusal=_BODIES),
    "moving edge gap": Support("bodies and two edges with air between", _BEHIND_BODIES, refusal=_BODIES),
    "moving edge and end": Support("bodies, an edge and an end of another", _BEHIND_BODIES, refusal=_BODIES),
    "moving scatterer": Support("bodies and a scatterer", _BEHIND_BODIES, refusal=_BODIES),
}


def media_of(air: Air) -> tuple[str, ...]:
    """List which of `MEDIA` an air is: more than one where wind, heights and fluctuations come together."""
    found = air.wind is not None, bool(air.layers), air.fluctuation is not None
    return tuple(name for name, there in zip(MEDIA[1:], found, strict=True) if there) or MEDIA[:1]


def support(kind: str, air: Air) -> str:
    """Give the least support that a kind of chains has in the media of an air: `DEVICE`, `HOST` or `REFUSED`."""
    row = dict(zip(MEDIA, SUPPORT[kind].where, strict=True))
    return max((row[medium] for medium in media_of(air)), key=(DEVICE, HOST, REFUSED).index)


def check_support(kind: str, air: Air) -> None:
    """Refuse a kind of chains where the medium does not support it.

    Raises
    ------
    InputError
        With the field and the rule of the matrix.
    """
    refusal = SUPPORT[kind].refusal
    if refusal is not None and support(kind, air) == REFUSED:
        raise InputError(*refusal)


def program_of(kind: str, air: Air) -> str | None:
    """Name the device's program of nodes for a kind of chains; None where the host makes them."""
    return SUPPORT[kind].program if support(kind, air) == DEVICE else None


def support_tables() -> str:
    """Write the matrix as tables of a page: paths by media, and methods by media."""
    head = f"{' | '.join(MEDIA)} |\n|{'---|' * (len(MEDIA) + 1)}"
    rows = [f"| {row.paths} | {' | '.join(row.where)} |" for row in SUPPORT.values()]
    methods = [
        f"| {name} | {' | '.join('yes' if medium in media else 'no' for medium in MEDIA)} |"
        for name, media in METHODS.items()
    ]
    return "\n".join([f"| nodes of paths by | {head}", *rows, "", f"| method | {head}", *methods])
