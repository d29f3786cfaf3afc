"""Names of entities in a Rerun recording."""

import re


def slug(text: str) -> str:
    """Words as one part of an entity path.

    >>> slug("Angle [deg]")
    'angle_deg'
    """
    return re.sub(r"\W+", "_", text.lower()).strip("_")


def part(text: str) -> str:
    """A name as one part of an entity path; the viewer titles lanes with it.

    >>> part("010 boom/tilt")
    '010_boom_tilt'
    """
    return re.sub(r"[^\w.-]+", "_", text)
