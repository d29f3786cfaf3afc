"""Puts the compiled loops into the wheel; where they cannot be compiled, it is one for every machine."""

import os
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.builders.wheel import WheelBuilderConfig

NATIVE = Path("schemas", "syncline_schemas", "native")


class NativeBuildHook(BuildHookInterface[WheelBuilderConfig]):
    """Compiles `schemas/syncline_schemas/native` in place, for wheels and for editable installs.

    With SYNCLINE_NATIVE=0 in the environment nothing is compiled; with 1 it is an error if nothing
    can be. Else a wheel without compiled loops is made then: numpy does their work, slower.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; name the platform in the tag of the wheel, which suits every Python."""
        wanted = os.environ.get("SYNCLINE_NATIVE")
        if wanted == "0":
            return
        try:
            builder = _builder(Path(self.root))
            builder.build()
        # Whatever a compiler, or the lack of one, may raise.
        except Exception as error:
            if wanted == "1":
                raise
            self.app.display_warning(f"syncline: without compiled loops, slower: {error}")
            return
        platform = self.build_config.builder.get_best_matching_tag().rsplit("-", 1)[1]
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["artifacts"].append(f"/{NATIVE.as_posix()}/{builder.LIBRARY.name}")


def _builder(root: Path) -> ModuleType:
    """The module that compiles; the package around it cannot be imported here."""
    spec = spec_from_file_location("syncline_native_build", root / NATIVE / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
