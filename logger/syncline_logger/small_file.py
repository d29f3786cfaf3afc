"""Small files that other programs read while they are replaced."""

import os
import re
from contextlib import suppress
from pathlib import Path

DRAFT_NAME = re.compile(r"\..+\.\d+\.tmp")
"""What a new content is called until it takes the old one's place.

A name that node_exporter (`*.prom`) and people's patterns (`*.json`) do not take.
"""


def replace_file(path: Path, content: str | bytes, *, durable: bool = False) -> None:
    """Write a file so that a reader sees the old content or the new one, never a part.

    durable: the content is on the disk before it takes the old one's place, so that a power cut
    leaves one of them too; the name itself is durable when the folder is synced.

    Raises OSError; the old content stays then.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with draft.open("wb") as stream:
            stream.write(data)
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        draft.replace(path)
    except OSError:
        with suppress(OSError):
            draft.unlink(missing_ok=True)
        raise
