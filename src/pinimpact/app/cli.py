"""The command line; heavy modules load when a verb needs them."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .. import __version__
from ..errors import PinimpactError, SimulationError

if TYPE_CHECKING:
    from rich.console import Console

OUT = click.option(
    "-o",
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("out"),
    show_default=True,
    help="Folder for the files, made if need be.",
)


INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def plain_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Say what is wrong with the input, or with a file, in one message without a traceback."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        try:
            return command(*args, **kwargs)
        except (PinimpactError, OSError) as error:
            raise click.ClickException(str(error)) from error

    return wrapped


class _Shown(logging.Handler):
    """Hands on the text of what is logged."""

    def __init__(self, show: Callable[[str], Any]) -> None:
        super().__init__()
        self._show = show

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        self._show(record.getMessage())


@contextmanager
def compiling_shown(console: Console, show: Callable[[str], Any]) -> Iterator[None]:
    """Hand what is told of the compiling of kernels to `show`, and to nobody else, if a terminal shows it."""
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


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pinimpact")
def main() -> None:
    """What happens to a robot in the instant in which it hits something with friction."""


@main.command()
@click.option("--robot", default="panda", show_default=True, help="Name of a robot, or path of a URDF file.")
@OUT
@plain_errors
def demo(robot: str, out: Path) -> None:
    """Let a robot strike a table: print the impact, write a replay and a hodograph."""
    from rich.console import Console

    from ..visual.html_replay import replay
    from ..visual.plots import impact_figure, save_figure
    from .demo import run_demo
    from .report import impact_report

    out.mkdir(parents=True, exist_ok=True)
    errors = Console(stderr=True)
    with errors.status("simulating") as status, compiling_shown(errors, status.update):
        shown = run_demo(robot)
    impact = shown.impact
    Console().print(impact_report(shown.robot.model, shown.contact, impact))
    contact, e = shown.contact, impact.problem.restitution
    title = f"{robot}: {contact.label}, μ = {contact.friction:g}, e = {e:g}"
    figure = save_figure(impact_figure(impact.problem, impact.solution, title), out / "hodograph.png")
    click.echo(f"Hodograph: {figure}")
    page = replay(shown.robot, shown.trajectory, out / "replay.html", speed=0.2)
    click.echo(f"Replay (five times slower, open in a browser): {page}")


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@plain_errors
def plan(scene: Path) -> None:
    """Print which effects a scene file calls for, and why each other one is left out."""
    from .scene_loader import load_scene

    click.echo(str(load_scene(scene).scene.plan()))


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@OUT
@plain_errors
def run(scene: Path, out: Path) -> None:
    """Simulate a scene file: print what happened, write trajectory, replay and pictures.

    Ctrl-C ends the run early, with exit status 130; what was computed until then is written all the same.
    """
    from rich.console import Console
    from rich.progress import Progress

    from .report import run_report
    from .scene_loader import load_scene

    loaded = load_scene(scene)
    out.mkdir(parents=True, exist_ok=True)
    stopped: PinimpactError | None = None
    with Progress(transient=True) as bar:
        task = bar.add_task("simulating", total=loaded.file.duration)
        try:
            with compiling_shown(bar.console, lambda text: bar.update(task, description=text)):
                trajectory = loaded.run(lambda t, _: bar.update(task, description="simulating", completed=t))
        except SimulationError as error:
            if error.partial is None:
                raise
            trajectory, stopped = error.partial, error
    Console().print(run_report(trajectory))
    for what, path in loaded.write(trajectory, out):
        click.echo(f"{what}: {path}")
    if stopped is not None:
        raise stopped
    if not trajectory.complete:
        raise SystemExit(INTERRUPTED)


@main.command()
@click.option(
    "--robot", help="Measure the demo's impact of this robot, not the standard classes of problems."
)
@click.option(
    "--target", type=click.FloatRange(min=0.0, min_open=True), help="Name the cheapest way to this error."
)
@click.option(
    "--method", "methods", multiple=True, help="A method to measure; may be repeated. [default: all]"
)
@click.option(
    "--time-cap",
    type=click.FloatRange(min=0.0, min_open=True),
    default=2.0,
    show_default=True,
    help="Seconds.",
)
@OUT
@plain_errors
def cost(
    robot: str | None, target: float | None, methods: tuple[str, ...], time_cap: float, out: Path
) -> None:
    """Measure error against time, method by method: a table, a diagram, the raw figures."""
    from ..studies.cost import run_cost

    out.mkdir(parents=True, exist_ok=True)
    problems = None
    if robot is not None:
        from .demo import run_demo

        problems = {robot: run_demo(robot).impact.problem}
    report = run_cost(
        problems,
        methods or None,
        time_cap=time_cap,
        progress=lambda name: click.echo(f"measuring {name}", err=True),
    )
    click.echo(report.table() if target is None else report.advice(target))
    report.plot(out / "cost.png")
    report.save(out / "cost.json")
    click.echo(f"Diagram: {out / 'cost.png'}\nFigures: {out / 'cost.json'}")
