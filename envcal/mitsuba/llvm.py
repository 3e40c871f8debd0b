"""Find an LLVM that Mitsuba's `llvm_*` variants can use, before they look for one themselves.

Dr.Jit loads the LLVM shared library when the first `llvm_*` variant is set, and takes what it finds first. Debian's
LLVM 14 is refused by it; 15 and 16 are taken, and then abort the whole process at the first `maximum` of two floats,
which their x86 back end cannot translate. So a good library is named in `DRJIT_LIBLLVM_PATH` in time, and a bad
one that was loaded nevertheless is refused while nothing has been compiled.
"""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from envcal.errors import EnvcalError

VARIABLE = "DRJIT_LIBLLVM_PATH"
#: Tried; newer ones are expected to work, and are taken after this one.
PROVEN = 19
_OLDEST = 15
_OLDEST_ON_X86 = 17
_REMEDY = (
    f"Install the Debian package `libllvm{PROVEN}` (Homebrew, conda-forge: llvm; Windows: the LLVM installer), or set "
    f"{VARIABLE} to an LLVM {_OLDEST_ON_X86} or newer, before Python starts; or use a scalar_* variant, which needs "
    f"none and is slow."
)
_PATTERNS = {
    "linux": (
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        "/opt/local/libexec/llvm-*/lib/libLLVM*.dylib",
    ),
    "win32": ("C:/Program Files/LLVM/bin/LLVM-C.dll",),
}


def version_of(path: Path) -> int | None:
    """Return the major version that the name of an LLVM library tells, symbolic links followed, or None."""
    for text in (path.name, str(path), str(path.resolve())):
        found = re.search(r"libLLVM(?:\.so\.|-)(\d{2})\b|llvm[-@/\\](\d{2})\b", text)
        if found:
            return int(found.group(1) or found.group(2))
    return None


def usable(version: int | None) -> bool:
    """Return whether code can be compiled with this major version on this machine; unknown versions may."""
    x86 = platform.machine().lower() in ("x86_64", "amd64", "i686", "x86")
    return version is None or version >= (_OLDEST_ON_X86 if x86 else _OLDEST)


def libraries() -> Iterator[Path]:
    """Yield the LLVM libraries that stand where systems put them, the conda environment's first."""
    prefix = Path(sys.prefix)
    for pattern in ("lib/libLLVM*.so*", "lib/libLLVM*.dylib", "Library/bin/LLVM-C.dll"):
        yield from sorted(prefix.glob(pattern))
    for place in _PATTERNS.get(sys.platform, _PATTERNS["linux"]):
        anchor = Path(place).anchor
        yield from sorted(Path(anchor).glob(str(Path(place).relative_to(anchor))))


def best(paths: Iterable[Path]) -> Path | None:
    """Return the library to use: the proven version, else the newest usable one of a known version, else None."""
    known = [(version, path) for path in paths if (version := version_of(path)) is not None and usable(version)]
    proven = [path for version, path in known if version == PROVEN]
    return proven[0] if proven else max(known, key=lambda pair: pair[0], default=(0, None))[1]


def provide() -> Path | None:
    """Name a good library in `DRJIT_LIBLLVM_PATH` unless it is set already; return what stands there then."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    found = best(libraries())
    if found is not None:
        os.environ[VARIABLE] = str(found)
    return found


def check_loaded(version: tuple[int, ...] | None) -> None:
    """Refuse the LLVM that Dr.Jit has loaded, given as (major, …), if compiling with it would end the process."""
    if version is not None and not usable(version[0]):
        raise EnvcalError(
            f"Mitsuba loaded LLVM {'.'.join(map(str, version))}; on {platform.machine()} that aborts the process as "
            f"soon as something is rendered (`Cannot select: fmaximum`). {_REMEDY}"
        )


def check_named() -> None:
    """Refuse a library named by hand in `DRJIT_LIBLLVM_PATH` that cannot work."""
    named = os.environ.get(VARIABLE)
    if not named:
        return
    path = Path(named)
    if path.is_absolute() and not path.exists():
        raise EnvcalError(f"{VARIABLE}={named}: there is no such file. {_REMEDY}")
    version = version_of(path)
    if not usable(version):
        raise EnvcalError(
            f"{VARIABLE}={named}: is LLVM {version}; {_OLDEST_ON_X86} or newer is needed here. Versions before "
            f"{_OLDEST} are refused by Mitsuba, {_OLDEST} and {_OLDEST + 1} abort the process. {_REMEDY}"
        )


def missing() -> EnvcalError:
    """Return the error for a machine without a usable LLVM."""
    seen = sorted({version for path in libraries() if (version := version_of(path)) is not None})
    what = f"only LLVM {', '.join(map(str, seen))}, which cannot be used" if seen else "none"
    return EnvcalError(f"Mitsuba's llvm_* variants need the LLVM library; there is {what}. {_REMEDY}")
