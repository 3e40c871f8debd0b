"""The group of all commands: mistakes become one message, Ctrl-C a stop."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import click

from envcal import __version__
from envcal.errors import EnvcalError

#: What shells expect of a program that was stopped by Ctrl-C.
INTERRUPTED = 130


class _Group(click.Group):
    """Turns a mistake in the input or in the settings into one message and exit status 1."""

    def invoke(self, ctx: click.Context) -> Any:
        _let_numba_cache()
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("envcal: stopped. Nothing is half-written; `envcal run` goes on where it stopped.", err=True)
            ctx.exit(INTERRUPTED)
        except (EnvcalError, ValueError) as error:
            if not _is_ours(error):
                raise
            click.echo(f"envcal: {error}" if "\n" not in str(error) else f"envcal: mistakes found:\n{error}", err=True)
            ctx.exit(1)


def _let_numba_cache() -> None:
    """Give numba a folder for its compiled code where neither the installation nor the home folder can be written.

    Without one it refuses to work at all. The folder is this process's own, since what numba loads from it is code.
    """
    home = Path.home() if os.environ.get("HOME") or os.name == "nt" else None
    writable = any(folder is not None and os.access(folder, os.W_OK) for folder in (Path(__file__).parent.parent, home))
    if "NUMBA_CACHE_DIR" not in os.environ and not writable:
        folder = tempfile.mkdtemp(prefix="envcal-")
        os.environ["NUMBA_CACHE_DIR"] = folder
        atexit.register(shutil.rmtree, folder, ignore_errors=True)


def _is_ours(error: Exception) -> bool:
    """Whether an error is a message for people; a ValueError of anybody else is our own mistake."""
    kinds = {EnvcalError.__name__, "CalibrateError", "UpliftError"}
    return any(kind.__name__ in kinds for kind in type(error).__mro__)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="envcal")
def main() -> None:
    """Bracketed RAW photographs in, a calibrated spectral environment map out.

    `envcal run pipeline.yaml` does everything; each stage is also a command of its own.
    """
