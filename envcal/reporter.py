"""What a person sees while work goes on: stages, progress, warnings.

Progress bars go to stderr and only to a terminal; warnings always go to stderr; the lines of finished stages go to
stdout unless the caller asked for JSON there.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

#: Called with (steps done, steps in all).
Progress = Callable[[int, int], None]


def silent(_done: int, _total: int) -> None:
    """A progress that shows nothing."""


class Reporter:
    """Shows the course of the work on the terminal."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet

    def say(self, text: str) -> None:
        """Print a line of results, unless stdout is kept for JSON."""
        if not self._quiet:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()

    def warn(self, text: str) -> None:
        """Print a warning to stderr."""
        sys.stderr.write(f"warning: {text}\n")
        sys.stderr.flush()

    @contextlib.contextmanager
    def progress(self, name: str) -> Iterator[Progress]:
        """Yield a function that moves a bar named `name`; without a terminal it does nothing."""
        if not sys.stderr.isatty():
            yield silent
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<10}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
        with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bars:
            task = bars.add_task(name, total=None)

            def move(done: int, total: int) -> None:
                bars.update(task, completed=done, total=total)

            yield move
