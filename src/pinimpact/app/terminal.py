"""Output of the commands: errors and warnings as lines, progress, results as tables or JSON."""

from __future__ import annotations

import functools
import json
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from ..errors import PinimpactError
from ..tables import nulls

if TYPE_CHECKING:
    from rich.console import Console

WIDE = 160
"""Minimum width of output that does not go to a terminal, for long names [columns]."""

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells: 128 plus the number of the signal."""


def plain_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Print errors of input and files as one message, without a traceback."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        with _warnings_as_lines():
            try:
                return command(*args, **kwargs)
            except BrokenPipeError:  # the reader of a pipe, such as `head`, has ended; click exits quietly
                raise
            except (PinimpactError, OSError) as error:
                raise click.ClickException(str(error)) from error
            except KeyboardInterrupt:
                click.echo("Interrupted.", err=True)
                raise SystemExit(INTERRUPTED) from None

    return wrapped


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print each warning in one line, without its source location."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: click.echo(f"Warning: {message}", err=True)
        yield


class _Shown(logging.Handler):
    """Shows log messages; the estimated time remains visible while kernels are counted."""

    def __init__(self, show: Callable[[str], Any]) -> None:
        super().__init__()
        self._show, self._time = show, ""

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        text = record.getMessage()
        if record.levelno >= logging.WARNING:
            self._time = f", {text.rpartition(': ')[2]}"
            self._show(text)
        else:
            self._show(text + self._time)


@contextmanager
def compiling_shown(console: Console, show: Callable[[str], Any]) -> Iterator[None]:
    """Send messages about compilation to `show` instead of the log, if the console is a terminal."""
    if not console.is_terminal:
        yield
        return
    logger = logging.getLogger("pinimpact.compiling")
    handler, level, propagates = _Shown(show), logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagates


@contextmanager
def working(quiet: bool, what: str) -> Iterator[Callable[[str], None]]:
    """Show progress and compilation on a terminal; yield a function that prints a line."""
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet)
    with console.status(what) as status, compiling_shown(console, status.update):

        def write(line: str) -> None:
            status.update(what)
            console.print(line, highlight=False, soft_wrap=True)

        yield write


@contextmanager
def simulating(quiet: bool) -> Iterator[Callable[[float, float], None]]:
    """Show a progress bar on a terminal; yield a function (done, whole) that updates it."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(transient=True, console=Console(stderr=True, quiet=quiet)) as bar:
        task = bar.add_task("simulating", total=None)
        with compiling_shown(bar.console, lambda text: bar.update(task, description=text)):
            yield lambda done, whole: bar.update(task, description="simulating", completed=done, total=whole)


def print_result(
    facts: Callable[[], Any],
    tables: Callable[[], Any],
    as_json: bool,
    quiet: bool,
    files: Mapping[str, Any] | None = None,
) -> None:
    """Print a result as JSON, as tables or text with the files that were written, or not at all."""
    if quiet:
        return
    if as_json:
        click.echo(json.dumps(nulls(facts()), ensure_ascii=False, allow_nan=False))
        return
    shown = tables()
    if isinstance(shown, str):
        click.echo(shown)
    else:
        from rich.console import Console

        console = Console()
        if not console.is_terminal:
            console = Console(width=max(WIDE, console.width))
        console.print(shown)
    for what, path in (files or {}).items():
        click.echo(f"{what}: {path}")
