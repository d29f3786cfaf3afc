"""Makes the library of this folder's C files: `python -m syncline_schemas.native.build`.

The build of the package calls it (`hatch_build.py`), so nothing but the standard library may be
imported here, and setuptools, which knows the compilers.
"""

import sys
import zlib
from pathlib import Path

FOLDER = Path(__file__).parent
LIBRARY = FOLDER / ("_kernels.dll" if sys.platform == "win32" else "_kernels.so")


def sources() -> list[Path]:
    """The C files, in order."""
    return sorted(FOLDER.glob("*.c"))


def fingerprint() -> int:
    """What the library tells of the sources that it was made of, however their lines end."""
    crc = 0
    for path in sorted(FOLDER.glob("*.[ch]")):
        crc = zlib.crc32(path.read_bytes().replace(b"\r\n", b"\n"), crc)
    return crc


def build() -> None:
    """Compile and link with the compiler that Python extensions are made with.

    Raises: whatever is wrong with it; there may be none.
    """
    import tempfile

    import setuptools  # noqa: F401  before its copy of distutils
    from setuptools._distutils.ccompiler import new_compiler
    from setuptools._distutils.sysconfig import customize_compiler

    compiler = new_compiler()
    customize_compiler(compiler)
    unix = compiler.compiler_type != "msvc"
    macros: list[tuple[str] | tuple[str, str | None]] = [
        ("SYNCLINE_FINGERPRINT", f"{fingerprint()}u")
    ]
    with tempfile.TemporaryDirectory() as folder:
        objects = compiler.compile(
            [str(path) for path in sources()],
            output_dir=folder,
            macros=macros,
            extra_preargs=["-O3", "-std=c99", "-fvisibility=hidden"] if unix else ["/O2"],
            # Behind the flags of the user: NaN and infinity are compared.
            extra_postargs=["-fno-fast-math", "-ffp-contract=off"] if unix else [],
        )
        # Another process may be running with the old one.
        made = Path(folder, LIBRARY.name)
        compiler.link_shared_object(objects, str(made))
        with tempfile.NamedTemporaryFile(dir=FOLDER, suffix=".tmp", delete=False) as fresh:
            fresh.write(made.read_bytes())
        Path(fresh.name).chmod(made.stat().st_mode)
        Path(fresh.name).replace(LIBRARY)


if __name__ == "__main__":
    build()
