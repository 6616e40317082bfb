"""Add the compiled kernels to a wheel, so that an installed package need not compile them.

python -m tools.fill_wheel dist/pinimpact-0.1.0-py3-none-any.whl

It needs an environment with the dependencies of the package, and makes a wheel for the Python, the version of
numba and the system of that environment, beside the one given. With another version of numba, or on an x86-64
processor without AVX2, its kernels are not used, and are compiled on first use.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from importlib.metadata import distribution
from pathlib import Path

from pinimpact._compile import portable

KEPT = ".nbi", ".nbc", ".json"
"""Suffixes of the cache files of kernels and of the file of hashes of their sources."""


def run(*command: str, **variables: str) -> None:
    """Run a module of Python."""
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT")}
    subprocess.run([sys.executable, "-m", *command], env=environment | variables, check=True)


def tags_of_numba() -> dict[str, str]:
    """Return the tags of the installed numba's wheel, as kernels run on the same platforms."""
    lines = (distribution("numba").read_text("WHEEL") or "").splitlines()
    tags = [line.removeprefix("Tag: ").split("-") for line in lines if line.startswith("Tag: ")]
    names = "--python-tag", "--abi-tag", "--platform-tag"
    return {name: ".".join(sorted({tag[k] for tag in tags})) for k, name in enumerate(names)}


def compile_into(folder: Path) -> None:
    """Compile all kernels into the folders of a package, for all usual processors."""
    variables = {"NUMBA_CPU_NAME": portable.processor(), "NUMBA_CPU_FEATURES": ""}
    run("pinimpact", "warmup", PYTHONPATH=str(folder), **variables)
    for file in folder.rglob("*"):
        if file.is_file() and file.parent.name == "__pycache__" and file.suffix not in KEPT:
            file.unlink()


def check(folder: Path) -> None:
    """Raise an error if a first impact or a first scene with a package compiles anything."""
    scene = folder / "pinimpact" / "scenes" / "solo12_landing.toml"
    with tempfile.TemporaryDirectory() as place:
        for command in (["demo"], ["run", str(scene)]):
            out = ["--quiet", "--out", str(Path(place, command[0]))]
            run("pinimpact", *command, *out, PYTHONPATH=str(folder), NUMBA_CACHE_DIR=place)
        made = [file.name for file in Path(place).rglob("*.nbc")]
    if made:
        raise SystemExit(f"these kernels are not in the wheel: {', '.join(made)}")


def fill(wheel: Path) -> None:
    """Write a wheel with compiled kernels beside one without."""
    with tempfile.TemporaryDirectory() as place:
        run("wheel", "unpack", "--dest", place, str(wheel))
        (content,) = Path(place).iterdir()
        compile_into(content)
        if portable.runs_here():
            check(content)
        (about,) = content.glob("*.dist-info/WHEEL")
        about.write_text(about.read_text().replace("Root-Is-Purelib: true", "Root-Is-Purelib: false"))
        run("wheel", "pack", "--dest-dir", place, str(content))
        (packed,) = Path(place).glob("*.whl")
        tags = [part for pair in tags_of_numba().items() for part in pair]
        run("wheel", "tags", "--remove", *tags, str(packed))
        (packed,) = Path(place).glob("*.whl")
        target = wheel.with_name(packed.name)
        target.write_bytes(packed.read_bytes())
    print(target)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Add the compiled kernels to a wheel.")
    parser.add_argument("wheel", type=Path, help="the wheel without kernels")
    fill(parser.parse_args().wheel)
