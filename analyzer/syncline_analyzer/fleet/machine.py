"""Which machine a capture is of."""

import re
from typing import Literal, Self

from syncline_analyzer.fleet.layout import stored_name
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

Source = Literal["rule", "recorder", "folder"]
_FIELD = re.compile(r"\{(\w+)\}")
_HOST = "host"


@dataclass(frozen=True, slots=True)
class MachineRule:
    """Where the name of a machine stands; by default in the capture, else in its folder's name.

    Attributes:
        pattern: finds the group `machine` in the path of a capture; None for the default.
        by_host: the name of the gateway that recorded is that of the machine.
    """

    pattern: re.Pattern[str] | None = None
    by_host: bool = False

    @classmethod
    def of(cls, text: str | None) -> Self:
        """A rule as a user writes it: `{machine}/{date}`, a regular expression, or `host`.

        Raises:
            UsageError: the text names no machine.
        """
        if text is None or text == _HOST:
            return cls(by_host=text == _HOST)
        try:
            pattern = re.compile(text if "(?P<machine>" in text else _template(text))
        except re.error as error:
            raise UsageError(f"--machine-from {text}: is no pattern: {error}") from error
        if "machine" not in pattern.groupindex:
            raise UsageError(
                f"--machine-from {text}: names no machine; write a template such as"
                ' "{machine}/{date}", a regular expression with (?P<machine>...), or host'
            )
        return cls(pattern)

    def machine(self, url: str, *, told: str = "", host: str = "") -> tuple[str, Source]:
        """Name of the machine as the data set has it, and where it was found.

        Args:
            url: URL or path of a capture, with `/` between the parts.
            told: what the recorder was told to call it.
            host: name of the gateway that recorded.
        """
        name, source = self._found(url, told, host)
        return stored_name(name), source

    def _found(self, url: str, told: str, host: str) -> tuple[str, Source]:
        folder, _, _ = url.rpartition("/")
        if self.pattern is not None:
            match = self.pattern.search(folder) or self.pattern.search(url)
            if match and match["machine"]:
                return match["machine"], "rule"
        if self.by_host and host:
            return host, "rule"
        if told:
            return told, "recorder"
        return folder.rpartition("/")[2] or "unknown", "folder"


def _template(text: str) -> str:
    """A template as a regular expression for the end of a path."""
    parts = _FIELD.split(text.strip("/"))
    literals = (
        re.escape(part).replace(r"\*", "[^/]*") if at % 2 == 0 else f"(?P<{part}>[^/]+?)"
        for at, part in enumerate(parts)
    )
    return rf"(?:^|/){''.join(literals)}$"
