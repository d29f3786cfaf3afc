"""Generate `syncline_pb2.py` and `.pyi`: `python -m syncline_schemas.proto.generate`.

protoc's Python output refuses to load on a protobuf runtime older than the protoc that made it,
although what it does (register a serialized descriptor and build classes from it) has not changed
since protobuf 3.20. The check is left out, so that one committed file serves every runtime that
the project allows.
"""

import re
import tempfile
from importlib import import_module
from pathlib import Path

PROTO = Path(__file__).with_name("syncline.proto")
ROOT = PROTO.parents[2]

_VERSION_CHECK = re.compile(
    r"^from google\.protobuf import runtime_version.*\n"
    r"|^_runtime_version\.ValidateProtobufRuntimeVersion\([^)]*\)\n"
    r"|^# Protobuf Python Version: .*\n",
    re.MULTILINE,
)


def generated() -> dict[Path, str]:
    """Text of each generated file by its place; needs the package grpcio-tools."""
    protoc = import_module("grpc_tools.protoc")
    with tempfile.TemporaryDirectory() as folder:
        source = PROTO.relative_to(ROOT).as_posix()
        arguments = ["protoc", f"-I{ROOT}", f"--python_out={folder}", f"--pyi_out={folder}", source]
        if protoc.main(arguments) != 0:
            raise RuntimeError(f"protoc failed on {PROTO}")
        made = Path(folder, source)
        return {
            PROTO.with_name(name): _VERSION_CHECK.sub("", text)
            for name in ("syncline_pb2.py", "syncline_pb2.pyi")
            for text in [made.with_name(name).read_text(encoding="utf-8")]
        }


def main() -> None:
    """Write the generated files beside the `.proto`."""
    for path, text in generated().items():
        path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
