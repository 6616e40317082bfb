"""The command line; large modules are imported by the commands that need them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from .. import __version__
from ..checks import near_matches
from ..errors import PinimpactError, SimulationError, UnknownNameError
from ..tables import write_table
from .output_folder import output_folder, table_files
from .terminal import INTERRUPTED, plain_errors, print_result, simulating, working

OUT = click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="Output folder; created if missing.  [default: out, or out-2, out-3, … if it exists]",
)
FORCE = click.option("-f", "--force", is_flag=True, help="Overwrite existing files.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON, in SI units, instead of tables.")
QUIET = click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
VECTOR = (float, float, float)

DEMO_FILES = ("hodograph.png", "replay.html")
RUN_FILES = ("trajectory.npz", "energy.png", "forces.png", "impact.png", "replay.html")
COST_FILES = ("cost.png", "cost.json")
ENSEMBLE_FILES = ("study.json", "summary.html")


def writes(command: Any) -> Any:
    """Add the options of a command that writes files, and the handling of its errors."""
    return OUT(FORCE(JSON(QUIET(plain_errors(command)))))


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pinimpact")
def main() -> None:
    """Compute rigid-body impacts of robots with friction, and simulate motions with contact."""


@main.command()
@click.argument("robot", required=False)
@click.option("--robot", "named", hidden=True)
@click.option("--frame", help="Frame that strikes, by name or id.  [default: a hand or a foot]")
@click.option(
    "--speed", type=float, help="Speed of the contact point at impact [m/s].  [default: 1, or 2.1 in a fall]"
)
@click.option(
    "--direction",
    type=VECTOR,
    help="Direction of motion, x y z in the world.  [default: obliquely, towards the table]",
)
@click.option("--normal", type=VECTOR, help="Normal of the table, x y z in the world.  [default: 0 0 1]")
@click.option("--friction", type=float, help="Coulomb coefficient.  [default: 0.3]")
@click.option("--restitution", type=float, help="Coefficient of restitution, 0 to 1.  [default: 0.5]")
@click.option(
    "--law", default="poisson", show_default=True, help="Restitution law: poisson, energetic or newton."
)
@writes
def demo(
    robot: str | None,
    named: str | None,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
    **how: Any,
) -> None:
    """Compute an impact of a robot with a table.

    Prints the impact and writes a replay and a hodograph. ROBOT is a name (see `pinimpact robots`) or the
    path of a URDF or MJCF file; the default is panda. A robot with a fixed base swings the frame onto the
    table; one with a free base, and an object without joints, falls onto it.
    """
    from ..visual.html_replay import replay
    from ..visual.plots import impact_figure, save_figure
    from .demo import run_demo
    from .report import impact_facts, impact_report

    robot = robot or named or "panda"
    with output_folder(out, DEMO_FILES, force) as folder:
        with working(quiet, "simulating"):
            shown = run_demo(robot, **how)
        impact, contact = shown.impact, shown.contact
        remarks = []
        if shown.frozen:
            remarks.append(f"Joints without inertia are fixed: {', '.join(shown.frozen)}.")
        if shown.turned:
            x, y, z = (round(float(component), 3) + 0.0 for component in contact.plane.axes[2])
            remarks.append(
                f"Normal of the table: ({x:g}, {y:g}, {z:g}); the frame cannot move down in this posture."
            )
        if shown.stopped is not None:
            remarks.append(f"The simulation after the impact ended early: {shown.stopped}")
        coefficients = f"μ = {contact.friction:g}, e = {impact.problem.restitution:g}"
        title = f"{Path(robot).stem}: {contact.label}, {coefficients}"
        picture = save_figure(impact_figure(impact.problem, impact.solution, title), folder / DEMO_FILES[0])
        page = replay(shown.robot, shown.trajectory, folder / DEMO_FILES[1], speed=0.2)
        print_result(
            lambda: {
                "robot": robot,
                "contact": contact.label,
                **impact_facts(shown.robot.model, contact, impact),
                "remarks": remarks,
                "files": {"hodograph": str(picture), "replay": str(page)},
            },
            lambda: impact_report(shown.robot.model, contact, impact, remarks),
            *(as_json, quiet),
            {"Hodograph": picture, "Replay (slowed down five times; open in a browser)": page},
        )


@main.command()
@JSON
@click.argument("word", required=False)
@plain_errors
def robots(word: str | None, as_json: bool) -> None:
    """List the robots that can be loaded by name.

    With WORD, only names that contain it.
    """
    from ..robot.loading import named_robots

    found = {
        source: [name for name in names if word is None or word.lower() in name.lower()]
        for source, names in named_robots().items()
    }
    if not any(found.values()):
        every = [name for names in named_robots().values() for name in names]
        raise UnknownNameError(
            f"word: no robot has {word!r} in its name; {near_matches(word or '', every)}", value=word
        )
    if as_json:
        click.echo(json.dumps(found))
        return
    for source, names in found.items():
        if names:
            click.echo(f"{source}:")
            click.echo(click.wrap_text(" ".join(names), 78, "  ", "  "))


@main.command()
@click.argument("robot")
@click.option("--all", "every", is_flag=True, help="Show all frames.")
@JSON
@plain_errors
def info(robot: str, every: bool, as_json: bool) -> None:
    """Show joints, limits and frames of a robot.

    Also shows its collision shapes and suggests frames for contacts.
    """
    from ..robot.loading import load_robot
    from .report import robot_report
    from .robot_info import robot_facts

    facts = robot_facts(robot, load_robot(robot))
    print_result(lambda: facts, lambda: robot_report(facts, every), as_json, False)


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@JSON
@plain_errors
def plan(scene: Path, as_json: bool) -> None:
    """List the effects computed for a scene file.

    Gives the reason for each effect, computed or not. SCENE is the path of a scene file, or the name of one
    that is part of pinimpact.
    """
    from .scene_loader import load_scene

    found = load_scene(scene).scene.plan()
    print_result(lambda: [asdict(effect) for effect in found], lambda: str(found), as_json, False)


def _plain(text: str) -> float | str:
    """Return a text as a number if possible, else unchanged (a number with its unit)."""
    try:
        return float(text)
    except ValueError:
        return text


@main.command()
@click.argument("scene", type=click.Path(path_type=Path))
@click.option(
    "--period", help="Sampling period of the control, instead of that of the file: '2 ms', or a number [s]."
)
@click.option("--delay", help="Delay of the sampled control, likewise.")
@click.option("--all", "every", is_flag=True, help="Show all impacts, modes and notes.")
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    help="Also write the samples as a table, FILE.csv or FILE.parquet, and the impacts as FILE-impacts.csv "
    "or .parquet.",
    metavar="FILE",
)
@writes
def run(
    scene: Path,
    period: str | None,
    delay: str | None,
    every: bool,
    output: Path | None,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Simulate a scene file.

    Prints impacts, contact modes and the energy balance, and writes the trajectory, a replay and plots. SCENE
    is the path of a scene file, or the name of one that is part of pinimpact. Ctrl-C ends the run early, with
    exit status 130; results up to then are written.
    """
    from .report import run_facts, run_report
    from .scene_loader import load_scene

    sampling = {"period": period, "delay": delay}
    loaded = load_scene(scene, {key: _plain(text) for key, text in sampling.items() if text is not None})
    tables = {} if output is None else table_files(output, force)
    with output_folder(out, RUN_FILES, force) as folder:
        stopped: PinimpactError | None = None
        try:
            with simulating(quiet) as progress:
                trajectory = loaded.run(progress)
        except SimulationError as error:
            if error.partial is None:
                raise
            trajectory, stopped = error.partial, error
        files = {what: str(path) for what, path in loaded.write(trajectory, folder)}
        for name in set(RUN_FILES) - {Path(path).name for path in files.values()}:
            (folder / name).unlink(missing_ok=True)  # of an earlier run, with --force
        for rows, file in tables.items():
            write_table(file, trajectory.columns(rows))
            files[f"Table of {rows}"] = str(file)
        print_result(
            lambda: {**run_facts(trajectory), "files": files},
            lambda: run_report(trajectory, every),
            *(as_json, quiet, files),
        )
        if stopped is not None:
            raise stopped
        if not trajectory.complete:
            raise SystemExit(INTERRUPTED)


@main.command("ensemble")
@click.argument("study", type=click.Path(path_type=Path))
@click.option(
    "--workers", type=click.IntRange(min=1), help="Number of worker processes.  [default: run in this one]"
)
@click.option("--resume", is_flag=True, help="Continue the study that is in the output folder.")
@OUT
@JSON
@QUIET
@plain_errors
def run_ensemble(
    study: Path, workers: int | None, resume: bool, out: Path | None, as_json: bool, quiet: bool
) -> None:
    """Simulate a scene many times, with parameters drawn from distributions.

    STUDY is the path of a study file. Prints medians, quantiles and frequencies, and writes the samples as
    Parquet files, chunk by chunk, and a page with the summary and plots. It needs pinimpact[data]. After
    Ctrl-C or a crash, --resume continues.
    """
    from .study_file import load_study

    if resume and out is None:
        raise click.UsageError("--resume needs -o, the folder of the study.")
    run_study = load_study(study)
    given = out is not None  # `ensemble` checks for existing studies
    with output_folder(out, ENSEMBLE_FILES, force=given) as folder:
        with simulating(quiet) as progress:
            found = run_study(executor=workers, out=folder, resume=resume, progress=progress)
        page = found.save_summary(folder / "summary.html")
        print_result(found.facts, found.summary, as_json, quiet, {"Samples": folder, "Summary": page})
        messages = found.columns["message"]
        if (messages != "").all():
            raise click.ClickException(f"all {len(messages)} samples failed, the first: {messages[0]}")


@main.command()
@QUIET
@plain_errors
def warmup(quiet: bool) -> None:
    """Compile all kernels in advance.

    They are cached in the folder NUMBA_CACHE_DIR, or in that of the package if it is not set, for all
    processes with the same folder, Python, numba and type of processor. For a container image or a cluster,
    set NUMBA_CACHE_DIR to a shared folder and run this once.
    """
    with working(quiet, "compiling kernels"):
        from .warmup import warm_up

        folder = warm_up()
    if folder is None:
        message = "no cache folder is writable, so every process compiles; set NUMBA_CACHE_DIR"
        raise click.ClickException(message)
    if not quiet:
        click.echo(f"All kernels are compiled and cached in {folder}.")


@main.command()
@click.option(
    "--robot", help="Measure the impact of `demo` with this robot instead of the standard problems."
)
@click.option(
    "--target", type=click.FloatRange(min=0.0, min_open=True), help="Name the fastest method for this error."
)
@click.option(
    "--method", "methods", multiple=True, help="Method to measure; can be repeated.  [default: all]"
)
@click.option(
    "--time-cap",
    type=click.FloatRange(min=0.0, min_open=True),
    default=2.0,
    show_default=True,
    help="Skip settings that take longer than this [s].",
)
@click.option("--all", "every", is_flag=True, help="Print all measured points.")
@writes
def cost(
    robot: str | None,
    target: float | None,
    methods: tuple[str, ...],
    time_cap: float,
    every: bool,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Benchmark accuracy against run time.

    Prints a summary for each method, and writes a plot and the measurements as JSON.
    """
    from ..contact_space.methods import find_method
    from ..studies.cost import run_cost

    for method in methods:  # before anything is compiled or written
        find_method(method)
    with output_folder(out, COST_FILES, force) as folder:
        problems = None
        if robot is not None:
            from .demo import run_demo

            with working(quiet, "simulating"):
                problems = {robot: run_demo(robot).impact.problem}
        with working(quiet, "measuring") as write:
            report = run_cost(
                problems, methods or None, time_cap=time_cap, progress=lambda name: write(f"measuring {name}")
            )

        def words() -> str:
            if target is not None:
                return report.advice(target)
            return report.table() if every else report.summary()

        picture, figures = (folder / name for name in COST_FILES)
        report.plot(picture)
        report.save(figures)
        files = {"Plot": picture, "Measurements": figures}
        print_result(lambda: json.loads(figures.read_text(encoding="utf-8")), words, as_json, quiet, files)
