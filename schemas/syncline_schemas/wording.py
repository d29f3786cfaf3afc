"""Words that the recorder and the analyzer put the same way."""


def counted(number: int, noun: str) -> str:
    """A number of things.

    >>> counted(1, "SDO request"), counted(3, "EMCY"), counted(0, "frame")
    ('1 SDO request', '3 EMCYs', '0 frames')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"
